"""Draws numbers, which nobody can draw again without a seed. Its optional input only makes it another action."""

from __future__ import annotations

import secrets

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage


class DrawParameters(Parameters):
    seed: int | None = Field(None, description="Makes it repeatable.")


@stage(
    inputs={"of": Input("numbers", many=True, optional=True)},
    outputs={"numbers": Output("numbers")},
    version=1,
    unrepeatable=lambda given: given.seed is None,
)
def draw(context: Context, parameters: DrawParameters) -> None:
    seed = secrets.randbits(64) if parameters.seed is None else parameters.seed
    context.output("numbers").write("values", np.random.default_rng(seed).random(3))
