"""Resumes work that has already taken a thousand seconds."""

from __future__ import annotations

import numpy as np

from pipeline.stage import Context, Output, Parameters, stage


class ResumedParameters(Parameters):
    """No parameters."""


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def resumed(context: Context, parameters: ResumedParameters) -> None:
    context.worked_before(1000.0)
    context.output("numbers").write("values", np.zeros(1))
