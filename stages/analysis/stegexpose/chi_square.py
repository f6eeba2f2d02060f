"""The chi-square attack (Westfeld and Pfitzmann 2000) as StegExpose 0.1 computes it."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import UInt8
from scipy.special import chdtrc

BLOCK = 1024
"""The number of bytes added to the histogram between two tests."""


def chi_square(picture: UInt8[np.ndarray, "H W 3"]) -> float:
    """The mean p-value of tests that the values 2k and 2k + 1 are equally frequent, over a growing histogram.

    Bytes are taken in the order R, G, B of each pixel, row by row. The last whole block, and any bytes after it, are
    left out. NaN for pictures of fewer than two blocks.
    """
    values = picture.reshape(-1)
    blocks = values.size // BLOCK - 1
    if blocks < 1:
        return math.nan
    block_of = np.repeat(np.arange(blocks) * 256, BLOCK)
    added = np.bincount(block_of + values[: blocks * BLOCK], minlength=blocks * 256).reshape(blocks, 256)
    histograms = 1 + added.cumsum(axis=0)  # every bin starts at 1
    observed = histograms[:, 0::2].astype(float)
    expected = ((histograms[:, 0::2] + histograms[:, 1::2]) // 2).astype(float)
    sums = observed.sum(axis=1), expected.sum(axis=1)
    scale = np.where(np.abs(sums[0] - sums[1]) > 1e-5, sums[0] / sums[1], 1.0)
    expected *= scale[:, None]
    statistics = ((observed - expected) ** 2 / expected).sum(axis=1)
    return float(chdtrc(observed.shape[1] - 1, statistics).mean())
