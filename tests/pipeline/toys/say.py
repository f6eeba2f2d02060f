"""Records which command made its result."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Output, Parameters, stage


class SayParameters(Parameters):
    word: str = Field(description="Any.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def say(context: Context, parameters: SayParameters) -> None:
    context.output("numbers").write("values", np.zeros(1))
    context.output("numbers").attributes["command"] = context.command
