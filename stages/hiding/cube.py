"""Room in the cube of features: how far one may go from a point inside without changing what is read along some rows.

Activated features, centred, lie in the cube [-`FARTHEST`, `FARTHEST`]^M. `read` are always orthonormal columns that
span what is read; N = 0 is allowed everywhere.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from stages.hiding.stored_features import FARTHEST

INSIDE = ((0.45, 100), (0.49, 1000), (0.499, 5000))
"""From 0.5, of each channel: how far points of origin lie at most, so that there is room around them, and so many times
they are brought nearer. The first is where most can lie. Where what is read is extreme there may be none so far inside,
and they are found slowly: of normally distributed raw features, 8 wide, 13 % are not in the cube after a hundred times,
0.7 % after 5,000."""


def origins_of(features: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"]) -> Float64[Tensor, "N M"]:
    """Points of which the same is read as of these centred features, inside the cube, if there are any.

    They change little where features do: going on for those outside leaves as it is what lies at the border.
    """
    known = (features @ read) @ read.T
    origins = known.clone()
    for inside, times in INSIDE:
        outside = origins.abs().amax(dim=1) > inside
        origins[outside] = _brought_inside(origins[outside], known[outside], read, inside, times)
    return origins


def is_cornered(origins: Float64[Tensor, "N M"]) -> Bool[Tensor, " N"]:
    """Whether there is no room around an origin."""
    return origins.abs().amax(dim=1) > FARTHEST


def room(origins: Float64[Tensor, "N M"], directions: Float64[Tensor, "N M"]) -> Float64[Tensor, " N"]:
    """How far each origin is from the border of the cube along its unit direction; 0 outside of it."""
    ends = torch.where(directions > 0, FARTHEST - origins, FARTHEST + origins) / directions.abs()
    return torch.where(directions == 0, torch.inf, ends).amin(dim=1).clamp_min(0)


def _brought_inside(
    points: Float64[Tensor, "N M"],
    known: Float64[Tensor, "N M"],
    read: Float64[Tensor, "M R"],
    inside: float,
    times: int,
) -> Float64[Tensor, "N M"]:
    """By projecting onto the smaller cube and onto what is read, in turn."""
    for _ in range(times if len(points) else 0):
        nearer = points.clamp(-inside, inside)
        points = known + nearer - (nearer @ read) @ read.T
    return points
