"""The criterion by which a picture counts as watermarked, and upper bounds of its false positive rate."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import beta
from torch import Tensor

DETECTION = 0.99
"""The share of the calibration renders that the threshold must detect."""

CONFIDENCE = 0.95
"""One-sided confidence of every upper bound."""


def explained_share(found: Float[Tensor, "H W 3"], watermark: Float[Tensor, "H W 3"]) -> float:
    """1 - |D_w(I) - W_cop|² / |W_cop|², the share of the watermark that the decoder's output explains.

    1 if the decoder shows the watermark, 0 if it shows black, negative if its output is farther from the watermark than
    black is. Raises `ValueError` for a black watermark, which could not be distinguished from none.
    """
    energy = float(watermark.double().square().sum())
    if energy == 0:
        raise ValueError("a black watermark cannot be told from none")
    return 1 - float((found.double() - watermark.double()).square().sum()) / energy


def threshold_at(scores: Sequence[float], detection: float = DETECTION) -> float:
    """The highest threshold that at least this share of the scores reaches. Raises `ValueError` if there are none.

    >>> threshold_at([0.1, 0.9, 0.8, 0.7], detection=0.75)
    0.7
    """
    if not scores:
        raise ValueError("no scores to set a threshold by")
    return sorted(scores, reverse=True)[math.ceil(detection * len(scores)) - 1]


def share_reaching(scores: Sequence[float], threshold: float) -> float:
    """The share of the scores that reach the threshold; NaN if there are none."""
    return float(np.mean(np.asarray(scores) >= threshold)) if len(scores) else math.nan


def upper_bound(successes: int, trials: int) -> float:
    """The one-sided Clopper-Pearson upper bound of a rate, for independent trials; 1 if there are none.

    >>> f"{upper_bound(0, 3000):.6f}", f"{upper_bound(0, 10):.3f}", upper_bound(2, 2)
    ('0.000998', '0.259', 1.0)
    """
    if successes >= trials:
        return 1.0
    return float(beta.ppf(CONFIDENCE, successes + 1, trials - successes))


def upper_bound_by_group(groups: Sequence[str], wrong: Collection[int]) -> float:
    """The same bound for the rate of groups, such as scenes, with any wrong trial.

    `groups` holds each trial's group, `wrong` the positions of the wrong trials. Pictures of one scene resemble each
    other, so thousands of them are hardly more than one trial. This bound assumes only that the scenes are independent:
    with few scenes it stays far from 0, whatever was measured. (A bootstrap over scenes would give 0 if no trial was
    wrong, since it resamples only what was observed.)

    >>> f"{upper_bound_by_group(['fox'] * 1000 + ['bonsai'] * 1000, []):.3f}"
    '0.776'
    """
    return upper_bound(len({groups[position] for position in wrong}), len(set(groups)))
