"""Roots of a x² + b x + c as StegExpose computes them, in floating point."""

from __future__ import annotations

import math


def real_roots(a: float, b: float, c: float) -> tuple[float, float] | None:
    """Both real roots, first the one with +√; None if they are complex.

    Both are NaN if a is 0, since the detectors' equations are meaningless then.
    """
    discriminant = b * b - 4 * a * c
    if discriminant < 0:
        return None
    if a == 0:
        return math.nan, math.nan
    root = math.sqrt(discriminant)
    return (root - b) / (2 * a), (-root - b) / (2 * a)


def ratio(above: float, below: float) -> float:
    """The quotient `above` / `below`; NaN if `below` is 0.

    >>> ratio(1, 2), ratio(1, 0)
    (0.5, nan)
    """
    return above / below if below else math.nan
