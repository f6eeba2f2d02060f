"""RS analysis (Fridrich, Goljan and Du 2001) as StegExpose 0.1 computes it, all groups at once.

A group is 2x2 pixels p0 p1 / p2 p3; its variation is the sum of the four absolute differences between neighbours. One
mask flips p0 and p3, the other p1 and p2; the counts of both are added. Overlapping groups begin at every pixel,
separate ones, a subset of these, at every other pixel of every other row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int, Int16, UInt8

from stages.analysis.stegexpose.quadratics import ratio, real_roots

Values = Int16[np.ndarray, "C H W"]


def rs_analysis(picture: UInt8[np.ndarray, "H W 3"]) -> float:
    """The message's length as a share of the lowest bits, averaged over channels and over both kinds of groups.

    NaN if an equation has no solution, and for a picture without groups.
    """
    if min(picture.shape[:2]) < 2:
        return math.nan
    values = np.ascontiguousarray(picture.transpose(2, 0, 1)).astype(np.int16)
    inverted = flip(values)
    counts = np.stack(
        [count_changes(each, flipped_by) for each in (values, inverted) for flipped_by in (flip, flip_shifted)], axis=2
    )
    lengths = [message_length(run.tolist()) for groups in counts for run in groups]
    return sum(lengths) / len(lengths)


def flip(values: Values) -> Values:
    """F1: 2k becomes 2k + 1, and 2k + 1 becomes 2k."""
    return values ^ 1


def flip_shifted(values: Values) -> Values:
    """F−1: 2k − 1 becomes 2k, and 2k becomes 2k − 1; 0 becomes −1, and 255 becomes 256."""
    return ((values + 1) ^ 1) - 1


def count_changes(values: Values, flipped_by: Callable[[Values], Values]) -> Int[np.ndarray, "2 C 2"]:
    """The numbers of groups whose variation a flip increases (regular) and decreases (singular), on the last axis.

    The first axis is overlapping and separate groups, the second the channels.
    """
    flipped = flipped_by(values)
    plain = _variation(values, values)
    counts = np.zeros((2, len(values), 2), int)
    for corners, others in ((flipped, values), (values, flipped)):
        changed = _variation(corners, others) - plain
        for row, groups in enumerate((changed, changed[:, ::2, ::2])):
            counts[row, :, 0] += np.count_nonzero(groups > 0, axis=(1, 2))
            counts[row, :, 1] += np.count_nonzero(groups < 0, axis=(1, 2))
    return counts


def _variation(corners: Values, others: Values) -> Int16[np.ndarray, "C G F"]:
    """The variation of every overlapping group, with p0 and p3 from `corners`, and p1 and p2 from `others`."""
    p0, p1 = corners[:, :-1, :-1], others[:, :-1, 1:]
    p2, p3 = others[:, 1:, :-1], corners[:, 1:, 1:]
    variation = np.abs(p0 - p1)
    for difference in (p3 - p2, p1 - p3, p2 - p0):
        variation += np.abs(difference, out=difference)
    return variation


def message_length(counts: Sequence[Sequence[int]]) -> float:
    """The message's length as a share of the lowest bits, from four (regular, singular) counts.

    They are by F1 and F−1, then by both once F1 has flipped all values; regular − singular is d0, d−0, d1 and d−1.
    The length is |x / (x − 1/2)| for the root x of smaller absolute value of
    2 (d1 + d0) x² + (d−0 − d−1 − d1 − 3 d0) x + (d0 − d−0), or for `_crossing` if the roots are complex.
    """
    d0, minus_d0, d1, minus_d1 = (regular - singular for regular, singular in counts)
    roots = real_roots(2 * (d1 + d0), minus_d0 - minus_d1 - d1 - 3 * d0, d0 - minus_d0)
    x = min(roots, key=abs) if roots else _crossing(counts)
    return abs(ratio(x, x - 0.5))


def _crossing(counts: Sequence[Sequence[int]]) -> float:
    """The place where straight lines through the counts cross, averaged over regular and singular groups."""
    plus, minus, plus_inverted, minus_inverted = counts
    crossings = [
        ratio(minus[kind] - plus[kind], plus_inverted[kind] - plus[kind] + minus[kind] - minus_inverted[kind])
        for kind in (0, 1)
    ]
    return sum(crossings) / 2
