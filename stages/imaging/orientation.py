"""EXIF orientation: how a viewer must rotate or mirror the pixels stored in a file."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from jaxtyping import UInt8
from PIL import Image

ORIENTATION = 0x0112
"""The EXIF tag."""
UPRIGHT = 1
SIDEWAYS = frozenset((5, 6, 7, 8))
"""Orientations that swap width and height."""
BACK_AS_STORED: Mapping[int, Image.Transpose] = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
"""From upright to stored pixels, by orientation."""
AS_VIEWED: Mapping[int, Image.Transpose] = {
    **BACK_AS_STORED,
    6: Image.Transpose.ROTATE_270,
    8: Image.Transpose.ROTATE_90,
}
"""From stored to upright pixels, by orientation. All but the quarter turns, 6 and 8, are their own inverses."""

BROKEN_EXIF = (OSError, SyntaxError, ValueError, TypeError, AttributeError, KeyError, ArithmeticError, struct.error)
"""What Pillow raises for tags of a wrong type, empty ones, or ones that point outside the data."""


def orientation_of(image: Image.Image) -> int:
    """The EXIF orientation, 1 to 8; 1 (upright) if it is missing, invalid or unreadable."""
    try:
        stated = image.getexif().get(ORIENTATION)
    except BROKEN_EXIF:
        return UPRIGHT
    return stated if isinstance(stated, int) and stated in AS_VIEWED else UPRIGHT


def upright(image: Image.Image) -> Image.Image:
    """The image as a viewer shows it.

    Pillow's own `exif_transpose` re-encodes all EXIF data, and so fails if any tag is broken.
    """
    orientation = orientation_of(image)
    return image if orientation == UPRIGHT else image.transpose(AS_VIEWED[orientation])


def as_stored(picture: UInt8[np.ndarray, "height width 3"], orientation: int) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of an upright picture as stored in a file of this orientation (2 to 8)."""
    return np.array(Image.fromarray(picture).transpose(BACK_AS_STORED[orientation]))
