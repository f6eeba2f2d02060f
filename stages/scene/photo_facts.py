"""What a photo's file says about it: size, focal length, orientation, and the camera that took it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from stages.imaging.orientation import BROKEN_EXIF, SIDEWAYS, UPRIGHT, orientation_of
from stages.imaging.pictures import open_picture, read_picture
from stages.scene.lens import Lens

EXIF_FOLDER, FOCAL_LENGTH_IN_35MM, FOCAL_LENGTH, MAKER, MODEL = 0x8769, 0xA405, 0x920A, 0x010F, 0x0110
DIAGONAL_OF_35MM = math.hypot(36, 24)


@dataclass(frozen=True)
class PhotoFacts:
    """Width and height, and the focal length in pixels if EXIF states it.

    `turned` is EXIF's orientation if the facts describe the pixels as stored, which a viewer would turn; else
    `UPRIGHT`. `camera` is EXIF's maker, model and focal length in millimetres; empty if it states no model.
    """

    size: tuple[int, int]
    focal_pixels: float | None
    turned: int = UPRIGHT
    camera: str = ""


def read_facts(photo: Path, posed: bool = False) -> PhotoFacts:
    """Facts of a photo, which is decoded entirely so that damage shows here; raises `UserError` as `read_picture` does.

    For a photo that is `posed` they describe the pixels as stored, and so do its pose and lens: COLMAP, and the
    programs that write transforms.json, ignore EXIF's orientation (for others, see `as_posed`). Other photos are
    described upright.
    """
    height, width = read_picture(photo).shape[:2]
    with open_picture(photo) as image:
        turned = orientation_of(image) if posed else UPRIGHT
        equivalent, camera = _millimetres(image, FOCAL_LENGTH_IN_35MM), _camera(image)
    size = (height, width) if turned in SIDEWAYS else (width, height)
    focal_pixels = None if equivalent is None else equivalent / DIAGONAL_OF_35MM * math.hypot(width, height)
    return PhotoFacts(size, focal_pixels, turned, camera)


def as_posed(facts: PhotoFacts, lens: Lens) -> PhotoFacts:
    """The facts of a posed photo, upright if its lens fits only that.

    Some programs turn photos by EXIF before they pose them, such as those of the DUSt3R family. Of a photo that is
    upside down, a lens does not tell.
    """
    turned = facts.turned in SIDEWAYS and (lens.width, lens.height) != facts.size
    return replace(facts, size=(lens.width, lens.height), turned=UPRIGHT) if turned else facts


def taken_by(photos: Mapping[str, Path], facts: Mapping[str, PhotoFacts]) -> tuple[int, ...]:
    """A number for each photo, equal for photos that one camera may have taken at one zoom.

    EXIF decides, or else the photo's folder, as for the cameras of a rig.
    """
    told = [facts[name].camera or f"in {photo.parent}" for name, photo in photos.items()]
    numbers = {camera: number for number, camera in enumerate(dict.fromkeys(told))}
    return tuple(numbers[camera] for camera in told)


def _camera(image: Image.Image) -> str:
    """Maker, model and focal length in millimetres; empty if EXIF states no model or is unreadable."""
    try:
        maker, model = (str(image.getexif().get(tag, "")).strip(" \0") for tag in (MAKER, MODEL))
    except BROKEN_EXIF:
        return ""
    return f"{maker} {model} {_millimetres(image, FOCAL_LENGTH) or 0:.2f}" if model else ""


def _millimetres(image: Image.Image, tag: int) -> float | None:
    """A focal length from EXIF; None if it is missing or unreadable, as SfM estimates it anyway."""
    try:
        millimetres = float(image.getexif().get_ifd(EXIF_FOLDER)[tag])
    except BROKEN_EXIF:
        return None
    return millimetres if math.isfinite(millimetres) and millimetres > 0 else None
