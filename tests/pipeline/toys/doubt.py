"""Makes a number, and has a remark about it."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Finished, Output, Parameters, Remark, stage


class DoubtParameters(Parameters):
    number: float = Field(1.0, description="Doubtful over 1; over 2 what should say so breaks.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1, remarks="tests.pipeline.toys.doubt:doubts")
def doubt(context: Context, parameters: DoubtParameters) -> None:
    context.output("numbers").write("values", np.array([parameters.number]))


def doubts(finished: Finished) -> tuple[Remark, ...]:
    (number,) = finished.outputs["numbers"].read("values")
    if number > 2:
        raise ZeroDivisionError("a defect")
    return (Remark("a doubtful number", f"It is {number}."),) if number > 1 else ()
