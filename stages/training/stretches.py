"""A point of a training's curves stands for a stretch of iterations; errors are told in decibels."""

from __future__ import annotations

import math

POINTS = 100
"""Of each curve, about."""

LEAST_ERROR = 1e-10
"""A squared error below it, of pictures in [0, 1], counts as this, so that equal pictures have a PSNR: 100 dB."""


def stretch_of(iterations: int) -> int:
    """How many iterations of a training one point stands for; at least one."""
    return max(1, iterations // POINTS)


def decibels_of(squared_error: float) -> float:
    """The PSNR, at most that of `LEAST_ERROR`."""
    return -10 * math.log10(max(squared_error, LEAST_ERROR))
