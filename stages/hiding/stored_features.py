"""Converting activated coupled features to the raw features that are stored."""

from __future__ import annotations

from jaxtyping import Float, Float64
from torch import Tensor

FARTHEST = 0.4999
"""Largest distance of an activated feature from 0.5, such that its logit can still be stored."""


def stored(features: Float64[Tensor, "N M"]) -> Float[Tensor, "N M"]:
    """The raw features of activated ones, which are clamped to the range that can be stored. N = 0 is allowed."""
    return features.clamp(0.5 - FARTHEST, 0.5 + FARTHEST).logit().float()
