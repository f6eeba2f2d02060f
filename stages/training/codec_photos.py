"""The photos of captures as a codec or a decoder learns from them: all in memory, none too large for that."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.artifact import Artifact
from stages.imaging.pictures import Picture, read_picture, resize_picture
from stages.imaging.shipped_photos import read_photo
from stages.scene.capture import picture_path, read_capture
from stages.scene.scene import TEST_VIEW_EVERY

LONGEST_SIDE = 800
"""Pixels; larger photos are reduced to it, so that hundreds fit into memory."""


def read_photos(capture: Artifact) -> list[Picture]:
    """The photos of a capture, in their order."""
    return [_no_larger(read_picture(picture_path(capture, name))) for name in read_capture(capture).names]


def learnt_photos(captures: Sequence[Artifact], shipped: Sequence[str]) -> list[Picture]:
    """The captures' photos but every eighth, which is held out, and those that packages ship, by their names."""
    photos = [photo for capture in captures for row, photo in enumerate(read_photos(capture)) if row % TEST_VIEW_EVERY]
    return photos + [read_photo(name) for name in shipped]


def _no_larger(photo: Picture) -> Picture:
    scale = LONGEST_SIDE / max(photo.shape[:2])
    return photo if scale >= 1 else resize_picture(photo, round(photo.shape[1] * scale), round(photo.shape[0] * scale))
