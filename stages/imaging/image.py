"""The `image` artifact, a named picture to hide, and its scaling to the size of a camera's picture."""

from __future__ import annotations

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.imaging.pictures import Picture, resize_picture

MOST_CUT_OFF = 64
"""Largest ratio of the scaled picture's area to the part kept; beyond it, next to nothing would be seen."""


def write_image(writer: ArtifactWriter, name: str, picture: Picture) -> None:
    """Write an `image` artifact.

    The picture is one chunk: by default, each row of a camera-sized picture would be stored as a file of its own.
    """
    writer.write("picture", picture, chunks=picture.shape)
    writer.attributes.update(name=name)


def read_image(artifact: Artifact) -> tuple[str, Picture]:
    """The name and the picture of an `image` artifact."""
    return str(artifact.attributes["name"]), artifact.read("picture")


def filling(picture: Picture, width: int, height: int) -> Picture:
    """The picture scaled to cover width x height, without distortion, and cropped to its centre.

    >>> import numpy as np
    >>> filling(np.zeros((40, 80, 3), np.uint8), 10, 20).shape
    (20, 10, 3)

    Raises `UserError` if more than 63/64 of the picture would be cut off.
    """
    longer = (picture.shape[1] * height) / (picture.shape[0] * width)
    if max(longer, 1 / longer) > MOST_CUT_OFF:
        raise UserError(
            "a picture cannot fill another of so different a shape",
            found=f"{picture.shape[1]} x {picture.shape[0]} pixels",
            expected=f"about the proportions of {width} x {height}",
            remedy="Choose another picture, or cut it out of this one.",
        )
    scale = max(width / picture.shape[1], height / picture.shape[0])
    whole = resize_picture(
        picture, max(width, round(picture.shape[1] * scale)), max(height, round(picture.shape[0] * scale))
    )
    top, left = (whole.shape[0] - height) // 2, (whole.shape[1] - width) // 2
    return whole[top : top + height, left : left + width].copy()
