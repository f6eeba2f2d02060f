"""EXIF's orientation: how a viewer is to turn or mirror the pixels that a file holds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from PIL import Image

from stages.imaging.pictures import Picture

ORIENTATION = 0x0112
"""EXIF's tag."""
UPRIGHT = 1
SIDEWAYS = frozenset((5, 6, 7, 8))
"""Those that exchange width and height."""
BACK_AS_STORED: Mapping[int, Image.Transpose] = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
"""What undoes a viewer's turn."""


def as_stored(upright: Picture, orientation: int) -> Picture:
    """The pixels as a file of this orientation, 2 to 8, holds them."""
    return np.array(Image.fromarray(upright).transpose(BACK_AS_STORED[orientation]))
