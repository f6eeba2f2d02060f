"""An image to hide: one picture with a name, and how it fills the picture of a camera."""

from __future__ import annotations

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.imaging.pictures import Picture, resize_picture

MOST_CUT_OFF = 64
"""Times the pixels that are kept: of a ribbon that fills a picture next to nothing is seen."""


def write_image(writer: ArtifactWriter, name: str, picture: Picture) -> None:
    """Write an `image` artifact, its picture as one file: of a camera's the engine would take rows for pictures."""
    writer.write("picture", picture, chunks=picture.shape)
    writer.attributes.update(name=name)


def read_image(artifact: Artifact) -> tuple[str, Picture]:
    """Its name and its picture."""
    return str(artifact.attributes["name"]), artifact.read("picture")


def filling(picture: Picture, width: int, height: int) -> Picture:
    """The picture scaled so that it just fills width x height, and its middle: nothing is stretched or left black.

    >>> import numpy as np
    >>> filling(np.zeros((40, 80, 3), np.uint8), 10, 20).shape
    (20, 10, 3)

    Raises `UserError` for a picture so long and narrow that more than 63 of 64 parts of it would be cut off.
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
