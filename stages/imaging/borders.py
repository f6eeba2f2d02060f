"""Removes plain borders around a picture, such as those of screenshots, letterboxes and white pages."""

from __future__ import annotations

import numpy as np

from stages.imaging.pictures import Picture

TOLERANCE = 8
"""Range, in levels of 255, within which a row counts as plain: JPEG changes plain areas by a few levels."""


PASSES = 4
"""Each removes at least one of several nested borders, such as a letterbox on a white page on a desktop. Limited, as
a hostile picture may be nothing but borders."""


def without_borders(picture: Picture) -> Picture:
    """The picture without the rows and columns at its edges that are of one colour each; a view, not a copy.

    Nested borders of any colours are removed in up to `PASSES` passes. A side of the result is 0 if nothing is left.
    """
    for _ in range(PASSES):
        across = _without_even_rows(picture).swapaxes(0, 1)
        inner = _without_even_rows(across).swapaxes(0, 1)
        if inner.shape == picture.shape:
            break
        picture = inner
    return picture


def _without_even_rows(picture: Picture) -> Picture:
    """The picture without its plain rows at the top and bottom; no rows if all are plain."""
    if picture.size == 0:
        return picture
    varied = np.flatnonzero((np.ptp(picture, axis=1) > TOLERANCE).any(axis=-1))
    return picture[varied[0] : varied[-1] + 1] if len(varied) else picture[:0]
