"""Frames of one colour around a picture, as screenshots, letterboxes and white pages have them."""

from __future__ import annotations

import numpy as np

from stages.imaging.pictures import Picture

TOLERANCE = 8
"""Levels of 255 in which a row of one colour may vary: JPEG changes what is even by a few."""


PASSES = 4
"""Each takes off one frame at least of those within one another, such as a letterbox on a white page on a desktop. A
hostile picture may be of nothing else."""


def without_frame(picture: Picture) -> Picture:
    """The picture without the rows and columns at its edges that are of one colour each; a view, not a copy.

    Frames within one another go, whatever their colours. Of a picture that is nothing else no pixel is left: a side is
    0.
    """
    for _ in range(PASSES):
        across = _without_even_rows(picture).swapaxes(0, 1)
        inner = _without_even_rows(across).swapaxes(0, 1)
        if inner.shape == picture.shape:
            break
        picture = inner
    return picture


def _without_even_rows(picture: Picture) -> Picture:
    """Without those before the first and after the last row that varies."""
    if picture.size == 0:
        return picture
    varied = np.flatnonzero((np.ptp(picture, axis=1) > TOLERANCE).any(axis=-1))
    return picture[varied[0] : varied[-1] + 1] if len(varied) else picture[:0]
