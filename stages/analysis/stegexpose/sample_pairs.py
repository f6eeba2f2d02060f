"""Sample pairs (Dumitrescu, Wu and Wang 2003) as StegExpose 0.1 computes them."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import UInt8

from stages.analysis.stegexpose.pair_counts import count_pairs
from stages.analysis.stegexpose.quadratics import ratio, real_roots


def sample_pairs(picture: UInt8[np.ndarray, "H W 3"]) -> float:
    """The share of changed lowest bits, from horizontal and vertical pairs, averaged over channels; may be negative.

    NaN if a side is odd: StegExpose reads past the edge of such pictures, and gives no value.
    """
    if picture.shape[0] % 2 or picture.shape[1] % 2:
        return math.nan
    return sum(_of_channel(np.ascontiguousarray(picture[..., channel])) for channel in range(3)) / 3


def _of_channel(values: UInt8[np.ndarray, "H W"]) -> float:
    """The root of smaller absolute value; c / b if the roots are complex or that root is exactly 0."""
    counts = count_pairs(values[:, 0::2], values[:, 1::2]) + count_pairs(values[0::2], values[1::2])
    a, b, c = counts.quadratic
    roots = real_roots(a, b, c)
    smaller = min(roots, key=abs) if roots else 0.0
    return smaller if smaller != 0 else ratio(c, b)
