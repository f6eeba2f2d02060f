"""Pictures side by side, in reading order."""

from __future__ import annotations

import numpy as np
import pytest

from stages.imaging.panels import columns_of, side_by_side


def numbered(count: int) -> list[np.ndarray]:
    return [np.full((2, 4, 3), number + 1, np.uint8) for number in range(count)]


@pytest.mark.parametrize("count", range(1, 10))
def test_every_picture_is_where_it_is_read(count: int) -> None:
    together = side_by_side(numbered(count))
    shown = together[::2, ::4, 0].ravel().tolist()
    assert shown == [*range(1, count + 1), *[0] * (len(shown) - count)]
    assert together.shape[1] == 4 * columns_of(count)


def test_many_large_pictures_are_shrunk() -> None:
    large = [np.full((1067, 1600, 3), 50 * number, np.uint8) for number in range(4)]
    together = side_by_side(large)
    assert together.shape == (320, 1920, 3)
    assert together[100, [240, 720, 1200, 1680], 0].tolist() == [0, 50, 100, 150]


def test_none_is_refused() -> None:
    with pytest.raises(ValueError, match="no pictures"):
        side_by_side([])
