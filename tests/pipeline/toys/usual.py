"""Makes the numbers of a file that need not be named: by default, one in the current folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field

from pipeline.stage import Context, ExternalPath, Output, Parameters, stage

HERE = Path("usual.txt")


class UsualParameters(Parameters):
    file: ExternalPath = Field(HERE, validate_default=False, description="One number a line; it may be missing.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def usual(context: Context, parameters: UsualParameters) -> None:
    there = parameters.file.is_file()
    context.output("numbers").write("values", np.loadtxt(parameters.file, ndmin=1) if there else np.zeros(0))
