"""Does the cover betray the message? Correlation of what the cover gets wrong with what is hidden there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, Shaped

from stages.imaging.metric_table import mean_of_known


def correlation(first: Float[np.ndarray, ...], second: Float[np.ndarray, ...]) -> float:
    """Pearson's correlation of two pictures' values; NaN where one of them is constant or empty."""
    if first.size == 0:
        return math.nan
    first, second = first - first.mean(), second - second.mean()
    norm = math.sqrt(float((first**2).sum()) * float((second**2).sum()))
    return float((first * second).sum()) / norm if norm > 0 else math.nan


def matched_correlations(
    readings: Sequence[Shaped[np.ndarray, ...]], messages: Sequence[Shaped[np.ndarray, ...]]
) -> tuple[list[float], list[float]]:
    """For each view, |correlation| of a reading, such as the cover's residual, with the message of that view, and with
    the other views'.

    The second is the matched control: a reading that knows nothing of its own view's message correlates with it no more
    than with the others. It is the mean over all other views that show something of the message, NaN where there is
    none. Values may be in any unit, bytes too; pictures are of one size.
    """
    own, others = [], []
    shown = np.empty((len(messages), messages[0].size if messages else 0), np.float32)
    for view, message in enumerate(messages):
        shown[view] = _standardised(message)
    for view, reading in enumerate(readings):
        values = np.abs(shown @ _standardised(reading)).tolist()
        own.append(values.pop(view))
        others.append(mean_of_known(values))
    return own, others


def _standardised(picture: Shaped[np.ndarray, ...]) -> Float32[np.ndarray, " K"]:
    """Its values, all of them of mean 0 and together of length 1: two such have their correlation as product.

    NaN where they are all one value. Done once for each picture: of T views there are T² pairs.
    """
    values = picture.ravel() - picture.mean(dtype=np.float64)
    length = math.sqrt(float(values @ values))
    return (values / length if length > 0 else np.full_like(values, math.nan)).astype(np.float32)
