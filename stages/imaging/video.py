"""Videos for browsers: AV1 in WebM, the same bytes for the same pictures.

Pillow's encoder of animated AVIF is an AV1 encoder with adjustable quality. OpenCV's video writer has no such setting,
and puts random identifiers into its files. The coded pictures are extracted from the AVIF file and written to WebM,
without creation times or random identifiers.
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
"""Decoded pictures then have a PSNR of 39 to 40 dB: an error far below that of the scenes shown."""

SPEED = 8
"""From 0 to 10; 6 takes six times as long for a tenth fewer bytes."""

SMALL = 800
"""Pictures with a longer side below this many pixels should be doubled: chroma is coded at half resolution, which
limits small pictures with fine colours to 32 dB at any quality."""


def encode_video(pictures: Sequence[Picture], pictures_a_second: float) -> bytes:
    """Encode two or more pictures, all of one size with even sides, as a WebM file.

    Only the first picture is a key frame. Raises `ValueError` for fewer pictures, other sizes, or a rate that is not
    positive, and `UserError` if Pillow was built without AVIF.
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


def doubled(picture: Picture) -> Picture:
    """The picture, each pixel repeated 2 x 2 if its longer side is below `SMALL`; exact once a viewer shrinks it."""
    factor = 2 if max(picture.shape) < SMALL else 1
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def encode_animation(pictures: Sequence[Picture]) -> bytes:
    """The pictures as an animated AVIF file, which contains its creation time."""
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
        subsampling="4:2:0",  # every AV1 decoder supports it, hardware ones included
        max_threads=1,
    )
    return buffer.getvalue()
