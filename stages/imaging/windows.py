"""Windows cut out of pictures: at random places and sizes, many of one size out of few photos; or the corners."""

from __future__ import annotations

import numpy as np

from stages.imaging.pictures import Picture, resize_picture


def random_window(picture: Picture, width: int, height: int, generator: np.random.Generator) -> Picture:
    """A window of this shape, anywhere in the picture and of any size that fits, scaled to width x height.

    Sizes are drawn evenly in their logarithm, from width x height up to the whole picture; a picture that is smaller
    than that gives its largest window, enlarged.
    """
    largest = min(picture.shape[1] / width, picture.shape[0] / height)
    scale = float(np.exp(generator.uniform(0, np.log(largest)))) if largest > 1 else largest
    across, down = (max(1, int(side * scale + 1e-9)) for side in (width, height))
    left = int(generator.integers(picture.shape[1] - across + 1))
    top = int(generator.integers(picture.shape[0] - down + 1))
    return resize_picture(picture[top : top + down, left : left + across], width, height)


def corners(picture: Picture, share: float) -> list[Picture]:
    """The four windows in the picture's corners, of this share of its sides, rounded down to even numbers of pixels.

    >>> [corner[0, 0].tolist() for corner in corners(np.indices((8, 12)).transpose(1, 2, 0), 0.5)]
    [[0, 0], [0, 6], [4, 0], [4, 6]]
    """
    height, width = picture.shape[:2]
    down, across = (int(share * side) // 2 * 2 for side in (height, width))
    return [
        picture[top : top + down, left : left + across] for top in (0, height - down) for left in (0, width - across)
    ]
