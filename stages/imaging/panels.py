"""Tiles pictures of one size into a single picture, so that in one video they play in step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.imaging.pictures import Picture, resize_picture

WIDEST_ROW = 4
"""Most pictures in a row."""

WIDEST = 1920
"""Largest width in pixels; few machines can play wider videos, so wider panels are shrunk."""


def columns_of(count: int) -> int:
    """Columns for `count` pictures: one row of up to four, otherwise as few even rows as possible.

    >>> [columns_of(count) for count in (1, 3, 4, 5, 6, 8, 9)]
    [1, 3, 4, 3, 3, 4, 3]
    """
    rows = -(-count // WIDEST_ROW)
    return -(-count // rows)


def side_by_side(pictures: Sequence[Picture]) -> Picture:
    """The pictures, all of one size, tiled in reading order; unused places at the end are black.

    A result wider than `WIDEST` is shrunk to it, with an even height. Raises `ValueError` if there are no pictures.
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
