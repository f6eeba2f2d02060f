"""What a photo's file says of itself: its size, its focal length, how it is turned, and what took it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from stages.imaging.orientation import BROKEN_EXIF, SIDEWAYS, UPRIGHT, orientation_of
from stages.imaging.pictures import open_picture, read_picture

EXIF_FOLDER, FOCAL_LENGTH_IN_35MM, FOCAL_LENGTH, MAKER, MODEL = 0x8769, 0xA405, 0x920A, 0x010F, 0x0110
DIAGONAL_OF_35MM = math.hypot(36, 24)


@dataclass(frozen=True)
class PhotoFacts:
    """Width and height, and the focal length in pixels where EXIF tells it.

    `turned` is EXIF's orientation where they are of the pixels as stored, from which a viewer would turn them.
    `camera` is what EXIF says of what took it: maker, model, and how far its lens was zoomed; empty where it is silent.
    """

    size: tuple[int, int]
    focal_pixels: float | None
    turned: int = UPRIGHT
    camera: str = ""


def read_facts(photo: Path, posed: bool = False) -> PhotoFacts:
    """Reads a photo to its last byte, so that damage shows here; raises `UserError` as `read_picture` does.

    Of a photo that is `posed` they are those of its pixels as stored: COLMAP, and what writes transforms.json, know
    nothing of EXIF's orientation, so that their poses and lenses are of those. Other photos are upright.
    """
    height, width = read_picture(photo).shape[:2]
    with open_picture(photo) as image:
        turned = orientation_of(image) if posed else UPRIGHT
        equivalent, camera = _millimetres(image, FOCAL_LENGTH_IN_35MM), _camera(image)
    size = (height, width) if turned in SIDEWAYS else (width, height)
    focal_pixels = None if equivalent is None else equivalent / DIAGONAL_OF_35MM * math.hypot(width, height)
    return PhotoFacts(size, focal_pixels, turned, camera)


def taken_by(photos: Mapping[str, Path], facts: Mapping[str, PhotoFacts]) -> tuple[int, ...]:
    """A number for each photo, equal for those that one camera may have taken, zoomed alike: by EXIF, and where it is
    silent by the folder that the photo lies in, as of a rig's cameras."""
    told = [facts[name].camera or f"in {photo.parent}" for name, photo in photos.items()]
    numbers = {camera: number for number, camera in enumerate(dict.fromkeys(told))}
    return tuple(numbers[camera] for camera in told)


def _camera(image: Image.Image) -> str:
    """Maker and model, and the focal length in millimetres; empty where EXIF tells no model, or cannot be read."""
    try:
        maker, model = (str(image.getexif().get(tag, "")).strip(" \0") for tag in (MAKER, MODEL))
    except BROKEN_EXIF:
        return ""
    return f"{maker} {model} {_millimetres(image, FOCAL_LENGTH) or 0:.2f}" if model else ""


def _millimetres(image: Image.Image, tag: int) -> float | None:
    """A focal length of EXIF's; None where it does not say, or cannot be read: SfM finds it as well."""
    try:
        millimetres = float(image.getexif().get_ifd(EXIF_FOLDER)[tag])
    except BROKEN_EXIF:
        return None
    return millimetres if math.isfinite(millimetres) and millimetres > 0 else None
