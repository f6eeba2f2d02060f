"""The classes of pictures that a detector is to distinguish, by their names in measurements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stages.analysis.measurements import Measurement
from stages.analysis.stegexpose.fusion import stegexpose
from stages.analysis.stored_views import Views

PHOTOS, HIDDEN, CLEAN, CLEAN_AGAIN = "photos", "hidden", "clean", "clean again"
"""Photos of the cover; renders of the container; renders of the same method trained without a message; and of the last
with another seed, a control for how far two trainings differ that both hide nothing."""


def stegexpose_rows(pictures: Views, names: Sequence[str], condition: str, method: str) -> Iterator[Measurement]:
    """The value of every StegExpose detector, and of their fusion, for every picture of a class; NaN if undefined.

    Odd sides are cropped by one pixel: sample pairs are undefined for them, so fusion over the remaining detectors
    would by itself separate a class of odd pictures from one of even pictures.
    """
    height, width = (side // 2 * 2 for side in pictures.shape[1:3])
    for name, picture in zip(names, pictures, strict=True):
        for detector, value in stegexpose(picture[:height, :width]).items():
            yield Measurement(detector, value, condition, view=name, method=method)
