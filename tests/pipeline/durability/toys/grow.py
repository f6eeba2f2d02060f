"""Grows arrays step by step, with a checkpoint after each. The result depends on the steps, not on interruptions."""

from __future__ import annotations

import time

import numpy as np
from pydantic import Field

from pipeline.errors import Interrupted
from pipeline.stage import Context, Input, Output, Parameters, stage
from tests.pipeline.durability.toys.told import tell

ARRAYS = 3


class GrowParameters(Parameters):
    seed: int = Field(0, description="Where the numbers begin.")
    steps: int = Field(8, ge=1, description="How many steps.")
    size: int = Field(20_000, ge=1, description="Numbers in an array.")
    pause: float = Field(0.01, ge=0, description="Seconds that a step takes.")


@stage(inputs={"numbers": Input("numbers", optional=True)}, outputs={"numbers": Output("numbers")}, version=1)
def grow(context: Context, parameters: GrowParameters) -> None:
    given = context.input_optional("numbers")
    values = np.random.default_rng(parameters.seed).random((ARRAYS, parameters.size))
    if given:
        values += given.read("values0").sum()
    checkpoint, first = context.scratch / "checkpoint.npz", 0
    if checkpoint.exists():
        with np.load(checkpoint) as saved:
            values, first = saved["values"], int(saved["step"]) + 1
    tell("begin", parameters.seed, first)
    for step in range(first, parameters.steps):
        values = np.sin(values * 3.0 + step)
        time.sleep(parameters.pause)
        aside = context.scratch / "aside.npz"
        np.savez(aside, values=values, step=step)
        aside.replace(checkpoint)
        tell("step", parameters.seed, step)
        if context.stop_requested():
            raise Interrupted
    for index, array in enumerate(values):
        context.output("numbers").write(f"values{index}", array, chunks=(5000,))
    context.output("numbers").write_file("notes/steps.txt", str(parameters.steps))
    tell("end", parameters.seed)
