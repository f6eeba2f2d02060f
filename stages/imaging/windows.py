"""Random windows of photos: many pictures of one size from a few photos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stages.imaging.pictures import Picture, resize_picture


def random_window(picture: Picture, width: int, height: int, generator: np.random.Generator) -> Picture:
    """A window of this aspect ratio, at a random place and of a random size, scaled to width x height.

    Sizes are log-uniform, from width x height up to the largest that fits. A picture smaller than width x height gives
    its largest window, enlarged.
    """
    largest = min(picture.shape[1] / width, picture.shape[0] / height)
    scale = float(np.exp(generator.uniform(0, np.log(largest)))) if largest > 1 else largest
    across, down = (max(1, int(side * scale + 1e-9)) for side in (width, height))
    left = int(generator.integers(picture.shape[1] - across + 1))
    top = int(generator.integers(picture.shape[0] - down + 1))
    return resize_picture(picture[top : top + down, left : left + across], width, height)


def windows_of_all(
    photos: Sequence[tuple[str, Picture]], count: int, width: int, height: int, generator: np.random.Generator
) -> Iterator[tuple[str, Picture]]:
    """Up to `count` random windows of the photos in turn, with their names, to test watermark detectors on.

    A photo smaller than width x height gives none, since enlarged windows lack fine grain. A photo of exactly that
    width or height gives at most as many as it has positions. So there may be fewer than `count`, or none at all.
    """
    left = [_most_windows(photo, width, height) for _, photo in photos]
    while count > 0 and any(left):
        for row, (name, photo) in enumerate(photos):
            if count > 0 and left[row] > 0:
                yield name, random_window(photo, width, height, generator)
                count, left[row] = count - 1, left[row] - 1


def is_as_large(photo: Picture, width: int, height: int) -> bool:
    """Whether `windows_of_all` yields windows of this photo."""
    return _most_windows(photo, width, height) > 0


def _most_windows(photo: Picture, width: int, height: int) -> float:
    """The number of different windows; infinite if their size can vary, too."""
    across, down = photo.shape[1] - width, photo.shape[0] - height
    if min(across, down) < 0:
        return 0
    return float("inf") if min(across, down) > 0 else across + down + 1
