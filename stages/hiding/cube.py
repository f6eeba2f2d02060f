"""Room in the feature cube: how far a feature can move inside it without changing what the given rows read.

Activated features, centred at 0, lie in the cube [-`FARTHEST`, `FARTHEST`]^M. `read` always holds orthonormal columns
that span what is read. N = 0 is allowed everywhere.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from stages.hiding.stored_features import FARTHEST

INSIDE = ((0.45, 100), (0.49, 1000), (0.499, 5000))
"""Rounds of projections: the largest magnitude of an origin's channels, which leaves room around it, and the number of
projections. Most origins meet the first bound. If what is read is extreme, there may be no such point, and convergence
is slow: for normally distributed raw features with M = 8, 13 % are outside the cube after 100 projections and 0.7 %
after 5,000."""


def origins_of(features: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"]) -> Float64[Tensor, "N M"]:
    """Points that read the same as these centred features, and lie inside the cube if there are such points.

    The map is continuous: each round only moves points outside its bound, and leaves those on the bound where they are.
    So small changes of the features move the origins little.
    """
    known = (features @ read) @ read.T
    origins = known.clone()
    for inside, times in INSIDE:
        outside = origins.abs().amax(dim=1) > inside
        origins[outside] = _brought_inside(origins[outside], known[outside], read, inside, times)
    return origins


def is_cornered(origins: Float64[Tensor, "N M"]) -> Bool[Tensor, " N"]:
    """Whether an origin lies outside the cube, so that there is no room around it."""
    return origins.abs().amax(dim=1) > FARTHEST


def room(origins: Float64[Tensor, "N M"], directions: Float64[Tensor, "N M"]) -> Float64[Tensor, " N"]:
    """The distance from each origin to the border of the cube along its unit direction; 0 for origins outside."""
    ends = torch.where(directions > 0, FARTHEST - origins, FARTHEST + origins) / directions.abs()
    return torch.where(directions == 0, torch.inf, ends).amin(dim=1).clamp_min(0)


def _brought_inside(
    points: Float64[Tensor, "N M"],
    known: Float64[Tensor, "N M"],
    read: Float64[Tensor, "M R"],
    inside: float,
    times: int,
) -> Float64[Tensor, "N M"]:
    """Project alternately onto the smaller cube and onto the points that read the same."""
    for _ in range(times if len(points) else 0):
        nearer = points.clamp(-inside, inside)
        points = known + nearer - (nearer @ read) @ read.T
    return points
