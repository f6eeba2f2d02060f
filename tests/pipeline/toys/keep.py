"""Saves two checkpoints and is then interrupted, as a training is by Ctrl-C."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pipeline.checkpoint import Checkpoints, State
from pipeline.errors import Interrupted
from pipeline.stage import Context, Output, Parameters, stage


class KeepParameters(Parameters):
    checkpoints: int = Field(2, ge=0, description="How many are kept.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def keep(context: Context, parameters: KeepParameters) -> None:
    checkpoints = Checkpoints(context)
    for number in range(parameters.checkpoints):
        checkpoints.save(State({"number": np.array(number)}, {}))
    raise Interrupted(f"stopped after number {parameters.checkpoints}")
