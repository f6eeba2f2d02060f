"""Pictures of one size side by side, as one picture: what plays in one video stays in step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.imaging.pictures import Picture, resize_picture

WIDEST_ROW = 4
"""Pictures in a row."""

WIDEST = 1920
"""Pixels; what is wider is shrunk, or several large pictures would make a picture that few machines can play."""


def columns_of(count: int) -> int:
    """How many of so many pictures stand in a row: all up to four, else half of them in two rows, and so on.

    >>> [columns_of(count) for count in (1, 3, 4, 5, 6, 8, 9)]
    [1, 3, 4, 3, 3, 4, 3]
    """
    rows = -(-count // WIDEST_ROW)
    return -(-count // rows)


def side_by_side(pictures: Sequence[Picture]) -> Picture:
    """The pictures in reading order; places that are left over at the end are black.

    Shrunk to `WIDEST` pixels, and then of even height. Raises `ValueError` for no pictures.
    """
    if not pictures:
        raise ValueError("there are no pictures to put side by side")
    columns = columns_of(len(pictures))
    empty = [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    filled = [*pictures, *empty]
    rows = [np.concatenate(filled[start : start + columns], axis=1) for start in range(0, len(filled), columns)]
    together = np.concatenate(rows, axis=0)
    height, width, _ = together.shape
    if width <= WIDEST:
        return together
    return resize_picture(together, WIDEST, max(2, 2 * round(height * WIDEST / width / 2)))
