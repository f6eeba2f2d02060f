"""The classes of pictures between which a detector is to tell, as rows of measurements name them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stages.analysis.measurements import Measurement
from stages.analysis.stegexpose.fusion import stegexpose
from stages.analysis.stored_views import Views

PHOTOS, HIDDEN, CLEAN, CLEAN_AGAIN = "photos", "hidden", "clean", "clean again"
"""Photos of the cover; renders of the container; of the same method trained without a message; of the same with another
seed, which tells how far two trainings differ that both hide nothing."""


def stegexpose_rows(pictures: Views, names: Sequence[str], condition: str, method: str) -> Iterator[Measurement]:
    """Every detector's value for every picture of a class, NaN where it gives none.

    Of an odd side the last line is left out: sample pairs give nothing for odd sides, and a class of odd pictures would
    be told from one of even pictures by the detectors that are left.
    """
    height, width = (side // 2 * 2 for side in pictures.shape[1:3])
    for name, picture in zip(names, pictures, strict=True):
        for detector, value in stegexpose(picture[:height, :width]).items():
            yield Measurement(detector, value, condition, view=name, method=method)
