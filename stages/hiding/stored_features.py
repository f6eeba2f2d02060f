"""Coupled features as they are stored, from activated ones."""

from __future__ import annotations

from jaxtyping import Float, Float64
from torch import Tensor

FARTHEST = 0.4999
"""From 0.5: so far may an activated feature lie, so that its logit can still be stored."""


def stored(features: Float64[Tensor, "N M"]) -> Float[Tensor, "N M"]:
    """Raw features, of activated ones; values that no sigmoid gives stop short of it. N = 0 is allowed."""
    return features.clamp(0.5 - FARTHEST, 0.5 + FARTHEST).logit().float()
