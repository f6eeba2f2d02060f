"""Windows cut out of photos at random places and sizes: many pictures of one size out of few photos."""

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
