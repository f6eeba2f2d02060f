"""StegExpose's output for a picture: the absolute value of every detector, capped at 1, and their mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import UInt8

from stages.analysis.stegexpose.chi_square import chi_square
from stages.analysis.stegexpose.primary_sets import primary_sets
from stages.analysis.stegexpose.rs_analysis import rs_analysis
from stages.analysis.stegexpose.sample_pairs import sample_pairs

DETECTORS: Mapping[str, Callable[[UInt8[np.ndarray, "H W 3"]], float]] = {
    "primary_sets": primary_sets,
    "chi_square": chi_square,
    "sample_pairs": sample_pairs,
    "rs_analysis": rs_analysis,
}
FUSION = "fusion"


def stegexpose(picture: UInt8[np.ndarray, "H W 3"]) -> dict[str, float]:
    """Every detector's value in [0, 1], NaN if undefined, and as `FUSION` the mean of those that are defined."""
    values = {name: at_most_one(abs(detector(picture))) for name, detector in DETECTORS.items()}
    return {**values, FUSION: fused(values)}


def at_most_one(value: float) -> float:
    """The value, or 1 if it is larger; NaN stays NaN.

    >>> at_most_one(1.5), at_most_one(0.5), at_most_one(math.nan)
    (1.0, 0.5, nan)
    """
    return 1.0 if value > 1 else value


def fused(values: Mapping[str, float]) -> float:
    """The mean of the values that are not NaN; NaN if there are none.

    >>> fused({"a": 0.25, "b": math.nan, "c": 0.75})
    0.5
    """
    given = [value for value in values.values() if not math.isnan(value)]
    return sum(given) / len(given) if given else math.nan
