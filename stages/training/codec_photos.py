"""The photos of captures as a codec or a decoder learns from them: all in memory, none too large for that."""

from __future__ import annotations

from pipeline.artifact import Artifact
from stages.imaging.pictures import Picture, read_picture, resize_picture
from stages.scene.capture import picture_path, read_capture

LONGEST_SIDE = 800
"""Pixels; larger photos are reduced to it, so that hundreds fit into memory."""


def read_photos(capture: Artifact) -> list[Picture]:
    """The photos of a capture, in their order."""
    return [_no_larger(read_picture(picture_path(capture, name))) for name in read_capture(capture).names]


def _no_larger(photo: Picture) -> Picture:
    scale = LONGEST_SIDE / max(photo.shape[:2])
    return photo if scale >= 1 else resize_picture(photo, round(photo.shape[1] * scale), round(photo.shape[0] * scale))
