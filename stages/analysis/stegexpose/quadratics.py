"""Roots of a x² + b x + c as StegExpose takes them: in floating point, NaN where there is none."""

from __future__ import annotations

import math


def real_roots(a: float, b: float, c: float) -> tuple[float, float] | None:
    """Both real roots, the one with the positive square root first; None where they are complex.

    Both are NaN where a is 0: the detectors' equations have lost their meaning there.
    """
    discriminant = b * b - 4 * a * c
    if discriminant < 0:
        return None
    if a == 0:
        return math.nan, math.nan
    root = math.sqrt(discriminant)
    return (root - b) / (2 * a), (-root - b) / (2 * a)


def ratio(above: float, below: float) -> float:
    """A quotient; NaN where it has no value.

    >>> ratio(1, 2), ratio(1, 0)
    (0.5, nan)
    """
    return above / below if below else math.nan
