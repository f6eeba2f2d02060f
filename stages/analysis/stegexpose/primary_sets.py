"""Primary sets (Dumitrescu, Wu and Memon 2002) as StegExpose 0.1 computes them."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import UInt8

from stages.analysis.stegexpose.pair_counts import count_pairs
from stages.analysis.stegexpose.quadratics import real_roots


def primary_sets(picture: UInt8[np.ndarray, "H W 3"]) -> float:
    """The share of changed lowest bits in the red channel, from horizontal pairs at x = 0, 2, 4 …; it may be negative.

    This is the algebraically smaller root; NaN if the roots are complex, or if there are no pairs.
    """
    red = np.ascontiguousarray(picture[..., 0])
    whole = red.shape[1] // 2 * 2
    roots = real_roots(*count_pairs(red[:, 0:whole:2], red[:, 1:whole:2], slip=True).quadratic)
    return min(roots) if roots else math.nan
