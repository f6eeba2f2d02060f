"""Windows cut out of photos: each trial is a picture of its own."""

from __future__ import annotations

import numpy as np
import pytest

from stages.imaging.pictures import Picture
from stages.imaging.windows import random_window, windows_of_all

WIDTH, HEIGHT = 12, 8


def photo(width: int, height: int) -> Picture:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_photos_take_turns_and_the_same_window_is_no_second_trial() -> None:
    """A photo of the window's size has one window, one with a row more has two; smaller photos would be enlarged."""
    sizes = {"same": (12, 8), "small": (11, 40), "row": (12, 9), "large": (24, 16)}
    photos = [(name, photo(*size)) for name, size in sizes.items()]
    windows = list(windows_of_all(photos, 7, WIDTH, HEIGHT, np.random.default_rng(0)))
    assert [name for name, _ in windows] == ["same", "row", "large", "row", "large", "large", "large"]
    assert {window.shape for _, window in windows} == {(HEIGHT, WIDTH, 3)}
    large = [window.tobytes() for name, window in windows if name == "large"]
    assert len(set(large)) == len(large)


def test_windows_are_at_any_place_and_of_all_sizes_as_often() -> None:
    """A photo that shows its own rows and columns; sizes are log-uniform, from one to ten times the window's."""
    rows, columns = np.mgrid[:160, :240].astype(np.uint8)
    picture, draws = np.stack([rows, columns, rows], axis=-1), np.random.default_rng(0)
    found = np.array([random_window(picture, 24, 16, draws).astype(float) for _ in range(400)])
    sizes = np.ptp(found[..., 1], axis=(1, 2)) / 23
    assert np.median(np.log10(sizes)) == pytest.approx(0.5, abs=0.08)
    for axis, length, side in ((0, 160, 16), (1, 240, 24)):
        free = length - side * sizes
        places = (found[..., axis].mean(axis=(1, 2)) - side * sizes / 2)[free > 20] / free[free > 20]
        assert places.mean() == pytest.approx(0.5, abs=0.05)
        assert places.std() == pytest.approx(12**-0.5, abs=0.05)


def test_there_may_be_fewer_or_none() -> None:
    generator = np.random.default_rng(0)
    assert len(list(windows_of_all([("same", photo(12, 8))], 5, WIDTH, HEIGHT, generator))) == 1
    assert list(windows_of_all([("small", photo(6, 4))], 5, WIDTH, HEIGHT, generator)) == []
    assert list(windows_of_all([], 5, WIDTH, HEIGHT, generator)) == []


def test_windows_have_their_shape_whatever_the_photo() -> None:
    draws = np.random.default_rng(0)
    for shape in ((64, 48), (10, 30), (500, 20)):
        photo = np.zeros((*shape, 3), np.uint8)
        assert all(random_window(photo, 20, 12, draws).shape == (12, 20, 3) for _ in range(20))
