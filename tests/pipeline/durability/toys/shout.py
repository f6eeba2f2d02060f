"""Prints and logs a lot."""

from __future__ import annotations

import os

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Output, Parameters, stage


class ShoutParameters(Parameters):
    lines: int = Field(1000, description="Of a kilobyte each, into the log.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def shout(context: Context, parameters: ShoutParameters) -> None:
    for _ in range(parameters.lines):
        context.log("x" * 1000)
    filler = context.scratch / "filler"
    filler.unlink(missing_ok=True)  # makes room for the result, but the log has lost lines by now
    context.output("numbers").write("values", np.arange(100.0))
    os.write(1, b"said by a library\n" * 10)
