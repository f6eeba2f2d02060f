"""`draw_key`: draw a container's secret key, which determines where in its features the messages are."""

from __future__ import annotations

import secrets

import numpy as np
from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import KEY_BYTES, write_key


class DrawKeyParameters(Parameters):
    """The source of the key."""

    seed: int | None = Field(
        None,
        ge=0,
        description="For experiments only: gives a reproducible key. If not set, the key is drawn from system entropy.",
    )


@stage(
    inputs={"container_of": Input("scene or views or image or splats or container", many=True, optional=True)},
    outputs={"key": Output("key", privacy="private")},
    version=1,
    unrepeatable=lambda given: given.seed is None,
)
def draw_key(context: Context, parameters: DrawKeyParameters) -> None:
    """Draw a key once; the store keeps it, so that a rerun hides with the same key.

    `container_of` are the inputs of the container, its cover and messages; other inputs get another key. Anyone who is
    shown the messages of one container has its secret, which would also read those of every other container with the
    same key. Without `container_of`, all containers of a store share one key.
    """
    drawn = (
        secrets.token_bytes(KEY_BYTES)
        if parameters.seed is None
        else np.random.default_rng(parameters.seed).bytes(KEY_BYTES)
    )
    write_key(context.output("key"), drawn)
