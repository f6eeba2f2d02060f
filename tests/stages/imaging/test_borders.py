"""Frames of one colour are taken off, and what is in them stays."""

from __future__ import annotations

import numpy as np
import pytest

from stages.imaging.borders import PASSES, without_borders
from stages.imaging.pictures import Picture, through_jpeg

INNER = np.random.default_rng(0).integers(0, 256, (40, 56, 3)).astype(np.uint8)
WHITE, BLACK, BLUE = (255, 255, 255), (0, 0, 0), (20, 60, 200)


def framed(picture: Picture, above: int, left: int, color: tuple[int, int, int]) -> Picture:
    """Add `above` rows above and below the picture, and `left` columns on either side."""
    height, width = picture.shape[:2]
    whole = np.full((height + 2 * above, width + 2 * left, 3), color, np.uint8)
    whole[above : above + height, left : left + width] = picture
    return whole


@pytest.mark.parametrize(
    "picture",
    [
        INNER,
        framed(INNER, 9, 0, BLACK),
        framed(INNER, 0, 16, WHITE),
        framed(INNER, 8, 5, BLUE),
        framed(framed(framed(INNER, 0, 7, BLACK), 11, 0, WHITE), 3, 4, BLUE),
    ],
)
def test_frames_are_taken_off(picture: Picture) -> None:
    assert np.array_equal(without_borders(picture), INNER)


def test_a_frame_after_jpeg_goes_but_for_the_blocks_at_its_edge() -> None:
    inner = without_borders(through_jpeg(framed(INNER, 32, 48, BLACK), 75))
    assert all(side <= kept <= side + 32 for side, kept in zip(INNER.shape[:2], inner.shape[:2], strict=True))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (24, 32)])
def test_of_one_colour_nothing_is_left(size: tuple[int, int]) -> None:
    assert without_borders(np.full((*size, 3), BLUE, np.uint8)).size == 0
    assert without_borders(np.zeros((0, 4, 3), np.uint8)).size == 0


def test_frames_without_end_are_taken_off_in_part() -> None:
    """There may be as many frames as half a side has pixels, so not each gets a pass of its own."""
    picture = INNER
    for count in range(4 * PASSES):
        picture = framed(picture, 2, 2, WHITE if count % 2 else BLACK)
    assert INNER.shape < without_borders(picture).shape < picture.shape
