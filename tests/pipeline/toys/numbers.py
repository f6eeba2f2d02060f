"""Makes numbers, from parameters or from a file."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pipeline.stage import Context, ExternalPath, Output, Parameters, stage


class NumbersParameters(Parameters):
    count: int = Field(3, ge=0, description="How many numbers.")
    first: float = Field(0.0, description="The first number.")
    note: str = Field("", description="Recorded, and without influence on the numbers.")
    file: ExternalPath | None = Field(None, description="A file with one number a line, instead.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def numbers(context: Context, parameters: NumbersParameters) -> None:
    if parameters.file:
        values = np.loadtxt(parameters.file, ndmin=1)
    else:
        values = parameters.first + np.arange(parameters.count, dtype=np.float64)
    context.record(device="none", note=parameters.note)
    context.output("numbers").write("values", values)
