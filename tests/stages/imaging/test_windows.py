"""Windows cut out of photos: each trial is a picture of its own."""

from __future__ import annotations

import numpy as np

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
