"""Stands for a stage that measures time, and so wants the machine to itself."""

from __future__ import annotations

import numpy as np

from pipeline.stage import Context, Output, Parameters, stage


class MeasureParameters(Parameters):
    """No parameters."""


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1, alone=True)
def measure(context: Context, parameters: MeasureParameters) -> None:
    context.output("numbers").write("values", np.zeros(1))
