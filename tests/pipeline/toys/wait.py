"""Works until it is asked to stop, and leaves a checkpoint; the second time it finishes."""

from __future__ import annotations

import time

import numpy as np

from pipeline.errors import Interrupted
from pipeline.stage import Context, Output, Parameters, stage


class WaitParameters(Parameters):
    """No parameters."""


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def wait(context: Context, parameters: WaitParameters) -> None:
    checkpoint = context.scratch / "checkpoint"
    if not checkpoint.exists():
        context.progress(1, 2)
        while not context.stop_requested():
            time.sleep(0.05)
        checkpoint.write_text("half")
        raise Interrupted
    context.output("numbers").write("values", np.zeros(1))
