"""`draw_key`: a secret key, from which follows where in the coupled features the messages lie."""

from __future__ import annotations

import secrets

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Output, Parameters, stage
from stages.hiding.key import KEY_BYTES, write_key


class DrawKeyParameters(Parameters):
    """Where the key comes from."""

    seed: int | None = Field(
        None, ge=0, description="For experiments: a key that anyone can draw again. Without it, the system's entropy."
    )


@stage(
    inputs={},
    outputs={"key": Output("key", privacy="private")},
    version=1,
    unrepeatable=lambda given: given.seed is None,
)
def draw_key(context: Context, parameters: DrawKeyParameters) -> None:
    """Draw a key once; the store keeps it, so that a rerun hides with the same one."""
    drawn = (
        secrets.token_bytes(KEY_BYTES)
        if parameters.seed is None
        else np.random.default_rng(parameters.seed).bytes(KEY_BYTES)
    )
    write_key(context.output("key"), drawn)
