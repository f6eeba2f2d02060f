"""What anyone can make of a container: renders of its cover in 8 bits."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import UInt8

from stages.hiding.method import Method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians


def each_render(gaussians: Gaussians, method: Method, cameras: Cameras) -> Iterator[Picture]:
    """Yield the cover from every camera in 8 bits; only one picture is held at a time."""
    for rendering in photographs(gaussians, method, cameras):
        yield tensor_to_picture(rendering.pictures[COVER])


def renders(
    gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None]
) -> UInt8[np.ndarray, "V H W 3"]:
    """The pictures of `each_render` in one array, empty without cameras; calls `after_each` after each picture."""
    pictures = np.empty((len(cameras), cameras.height, cameras.width, 3), np.uint8)
    for row, picture in enumerate(each_render(gaussians, method, cameras)):
        pictures[row] = picture
        after_each()
    return pictures
