"""When a picture counts as watermarked, and how sure one can be of how seldom that is wrong."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import beta
from torch import Tensor

DETECTION = 0.99
"""Of the renders that set the threshold, so many are to be found."""

CONFIDENCE = 0.95
"""One-sided, of every upper bound."""


def explained_share(found: Float[Tensor, "H W 3"], watermark: Float[Tensor, "H W 3"]) -> float:
    """1 - |D_w(I) - W_cop|² / |W_cop|²: 1 where the decoder shows the watermark, 0 where it shows black.

    Below 0 where it shows something that is no nearer to the watermark than black. Raises `ValueError` for a black
    watermark, which could not be told from none.
    """
    energy = float(watermark.double().square().sum())
    if energy == 0:
        raise ValueError("a black watermark cannot be told from none")
    return 1 - float((found.double() - watermark.double()).square().sum()) / energy


def threshold_at(scores: Sequence[float], detection: float = DETECTION) -> float:
    """The highest threshold that at least this share of the scores reaches. Raises `ValueError` without scores.

    >>> threshold_at([0.1, 0.9, 0.8, 0.7], detection=0.75)
    0.7
    """
    if not scores:
        raise ValueError("no scores to set a threshold by")
    return sorted(scores, reverse=True)[math.ceil(detection * len(scores)) - 1]


def share_reaching(scores: Sequence[float], threshold: float) -> float:
    """How many of the scores reach the threshold; NaN without scores."""
    return float(np.mean(np.asarray(scores) >= threshold)) if len(scores) else math.nan


def upper_bound(successes: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Clopper and Pearson's upper bound of a rate, one-sided; 1 without trials.

    It holds for trials that are independent of each other.

    >>> f"{upper_bound(0, 3000):.6f}", f"{upper_bound(0, 10):.3f}", upper_bound(2, 2)
    ('0.000998', '0.259', 1.0)
    """
    if successes >= trials:
        return 1.0
    return float(beta.ppf(confidence, successes + 1, trials - successes))


def upper_bound_by_group(groups: Sequence[str], wrong: Collection[int], confidence: float = CONFIDENCE) -> float:
    """The same for how many groups, such as scenes, have any wrong trial; `wrong` are positions among `groups`.

    Pictures of one scene resemble each other, so that thousands of them are hardly more than one trial. This bound asks
    nothing of them but that scenes are independent: with few scenes it stays far from 0, whatever was measured. (A
    bootstrap over scenes would say 0 where no trial was wrong: it knows nothing but what it has seen.)

    >>> f"{upper_bound_by_group(['fox'] * 1000 + ['bonsai'] * 1000, []):.3f}"
    '0.776'
    """
    return upper_bound(len({groups[position] for position in wrong}), len(set(groups)), confidence)
