"""Room in the cube of features: how far one may go from a point inside without changing what is read along some rows.

Activated features, centred, lie in the cube [-`FARTHEST`, `FARTHEST`]^M. `read` are always orthonormal columns that
span what is read; N = 0 is allowed everywhere.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from stages.hiding.stored_features import FARTHEST

INSIDE = (0.45, 0.49, 0.499)
"""From 0.5, of each channel: how far points of origin lie at most, so that there is room around them: the first where
there are such points. Where what is read is extreme there may be none that is so far inside."""

ROUNDS = 100
"""Of projections onto what is read and onto the cube: no Gaussian of the fox or kitchen needed more."""


def origins_of(features: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"]) -> Float64[Tensor, "N M"]:
    """Points of which the same is read as of these centred features, inside the cube, if there are any."""
    known = (features @ read) @ read.T
    origins = _nearest_inside(known, read, INSIDE[0])
    for inside in INSIDE[1:]:
        outside = is_cornered(origins)
        origins[outside] = _nearest_inside(known[outside], read, inside)
    return origins


def is_cornered(origins: Float64[Tensor, "N M"]) -> Bool[Tensor, " N"]:
    """Whether there is no room around an origin."""
    return origins.abs().amax(dim=1) > FARTHEST


def room(origins: Float64[Tensor, "N M"], directions: Float64[Tensor, "N M"]) -> Float64[Tensor, " N"]:
    """How far each origin is from the border of the cube along its unit direction; 0 outside of it."""
    ends = torch.where(directions > 0, FARTHEST - origins, FARTHEST + origins) / directions.abs()
    return torch.where(directions == 0, torch.inf, ends).amin(dim=1).clamp_min(0)


def _nearest_inside(
    known: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"], inside: float
) -> Float64[Tensor, "N M"]:
    """By projecting onto the smaller cube and onto what is read, in turn."""
    points = known
    for _ in range(ROUNDS):
        nearer = points.clamp(-inside, inside)
        points = known + nearer - (nearer @ read) @ read.T
    return points
