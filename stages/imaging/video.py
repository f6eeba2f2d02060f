"""Videos that a browser plays: AV1 in WebM, the same bytes for the same pictures.

Pillow's encoder of animated AVIF is an AV1 encoder whose quality can be set, unlike that of OpenCV's videos, which is
also what random identifiers come from. The coded pictures are taken out of its file and put into WebM, which holds no
times and no identifiers of its own making.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

from PIL import Image, features

from pipeline.errors import UserError
from stages.imaging.iso_media import coded_pictures
from stages.imaging.pictures import Picture
from stages.imaging.webm import write_webm

QUALITY = 85
"""With it, decoded pictures have 39 to 40 dB against those encoded: an error far under that of the scenes shown."""

SPEED = 8
"""Of 0 to 10; at 6, six times as long for a tenth less bytes."""

SMALL = 800
"""Pixels on the long side, under which pictures should be doubled: colours are coded at half the size of brightness,
and no quality gets small pictures with fine colours over 32 dB otherwise."""


def encode_video(pictures: Sequence[Picture], pictures_a_second: float) -> bytes:
    """Two or more pictures, all of one size with even sides, as a WebM file.

    Only the first picture can be decoded by itself. Raises `ValueError` for fewer, other sizes, or a rate that is not
    positive, and `UserError` where Pillow was built without AVIF.
    """
    sizes = {picture.shape for picture in pictures}
    odd = any(side % 2 for height, width, _ in sizes for side in (height, width))
    if len(pictures) < 2 or len(sizes) > 1 or odd or pictures_a_second <= 0:
        raise ValueError(f"a video of {len(pictures)} pictures of the sizes {sizes}, {pictures_a_second} a second")
    if not features.check("avif"):
        raise UserError(
            "videos cannot be encoded",
            found="Pillow without AVIF",
            expected="Pillow 11.3 or newer, as it comes from PyPI",
            remedy="Run pip install 'pillow>=11.3'",
        )
    configuration, coded = coded_pictures(encode_animation(pictures))
    height, width, _ = pictures[0].shape
    return write_webm(configuration, coded, (width, height), pictures_a_second)


def enlarged(picture: Picture) -> Picture:
    """The picture, each pixel twice as wide and as high if it is small: exact, and averaged away again by a viewer."""
    factor = 2 if max(picture.shape) < SMALL else 1
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def encode_animation(pictures: Sequence[Picture]) -> bytes:
    """The pictures as an animated AVIF file, which holds the time at which it was made."""
    images = [Image.fromarray(picture) for picture in pictures]
    buffer = io.BytesIO()
    images[0].save(
        buffer,
        "AVIF",
        save_all=True,
        append_images=images[1:],
        duration=1,
        quality=QUALITY,
        speed=SPEED,
        subsampling="4:2:0",  # what every decoder of AV1 plays, those of hardware included
        max_threads=1,
    )
    return buffer.getvalue()
