"""Leakage of the message into the cover: the correlation of the cover's residual with the message."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, Shaped

from stages.imaging.metric_table import mean_of_known


def correlation(first: Float[np.ndarray, ...], second: Float[np.ndarray, ...]) -> float:
    """Pearson's correlation of two pictures' values; NaN if either is constant or empty."""
    if first.size == 0:
        return math.nan
    first, second = first - first.mean(), second - second.mean()
    norm = math.sqrt(float((first**2).sum()) * float((second**2).sum()))
    return float((first * second).sum()) / norm if norm > 0 else math.nan


def matched_correlations(
    readings: Sequence[Shaped[np.ndarray, ...]], messages: Sequence[Shaped[np.ndarray, ...]]
) -> tuple[list[float], list[float]]:
    """For each view, |correlation| of a reading, such as the cover's residual, with that view's message and the others.

    The second list is the matched control: a reading without information about its own view's message correlates no
    more with it than with the messages of other views. Its entries are means over the other views that show something
    of the message, NaN if there are none. Values may be in any unit, including bytes; all pictures have the same size.
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
    """The picture's values, centred and scaled to unit norm, so that a dot product of two is their correlation.

    NaN if the picture is constant. Computed once per picture, since T views have T² pairs.
    """
    values = picture.ravel() - picture.mean(dtype=np.float64)
    length = math.sqrt(float(values @ values))
    return (values / length if length > 0 else np.full_like(values, math.nan)).astype(np.float32)
