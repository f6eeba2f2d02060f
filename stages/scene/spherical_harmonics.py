"""View-dependent colour: real spherical harmonics up to degree 3, in the order and sign of 3DGS."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

MAXIMUM_DEGREE = 3
SH_BASE, SH_REST = "sh_base", "sh_rest"
"""Attributes of Gaussians in methods without features: the constant harmonic [N, 3], and the others [N, K, 3]."""

CONSTANT_HARMONIC = 0.5 / math.sqrt(math.pi)
"""The constant harmonic Y00; a colour c is stored as (c - 0.5) / CONSTANT_HARMONIC."""


def harmonics_count(degree: int) -> int:
    """(degree + 1)², the number of harmonics up to `degree`. Raises `ValueError` for a degree outside 0..3."""
    _check_degree(degree)
    return (degree + 1) ** 2


def harmonics(directions: Float[Tensor, "*batch 3"], degree: int) -> Float[Tensor, "*batch K"]:
    """Values of the real harmonics, K = (degree + 1)², at unit `directions`, with the Condon-Shortley signs of 3DGS.

    Raises `ValueError` for a degree outside 0..3.
    """
    _check_degree(degree)
    x, y, z = directions.movedim(-1, 0).contiguous()  # contiguous, like the results: half the time
    values = [torch.full_like(x, CONSTANT_HARMONIC)]
    if degree >= 1:
        first = math.sqrt(3 / (4 * math.pi))
        values += [-first * y, first * z, -first * x]
    if degree >= 2:
        second = math.sqrt(15 / (4 * math.pi))
        xx, yy, zz = x * x, y * y, z * z
        values += [
            second * x * y,
            -second * y * z,
            math.sqrt(5 / (16 * math.pi)) * (2 * zz - xx - yy),
            -second * x * z,
            second / 2 * (xx - yy),
        ]
    if degree >= 3:
        outer = math.sqrt(35 / (32 * math.pi))
        middle = math.sqrt(105 / (4 * math.pi))
        inner = math.sqrt(21 / (32 * math.pi))
        values += [
            -outer * y * (3 * xx - yy),
            middle * x * y * z,
            -inner * y * (4 * zz - xx - yy),
            math.sqrt(7 / (16 * math.pi)) * z * (2 * zz - 3 * xx - 3 * yy),
            -inner * x * (4 * zz - xx - yy),
            middle / 2 * z * (xx - yy),
            -outer * x * (xx - 3 * yy),
        ]
    return torch.stack(values).movedim(0, -1)


def _check_degree(degree: int) -> None:
    if not 0 <= degree <= MAXIMUM_DEGREE:
        raise ValueError(f"spherical harmonics have degree 0 to {MAXIMUM_DEGREE} here, not {degree}")
