"""Stretches of iterations, each of which is a point of a training's curves; errors are given in decibels."""

from __future__ import annotations

import math

POINTS = 100
"""Approximate number of points of each curve."""

LEAST_ERROR = 1e-10
"""Lower bound on squared errors of pictures in [0, 1], so that equal pictures have a finite PSNR: 100 dB."""


def stretch_of(iterations: int) -> int:
    """The number of iterations of a training that one point stands for; at least one."""
    return max(1, iterations // POINTS)


def decibels_of(squared_error: float) -> float:
    """The PSNR in dB of pictures in [0, 1], at most that of `LEAST_ERROR`."""
    return -10 * math.log10(max(squared_error, LEAST_ERROR))
