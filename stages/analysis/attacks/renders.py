"""Distortions of the cover's pictures after rendering."""

from __future__ import annotations

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from stages.analysis.attacks.target import Target
from stages.imaging.pictures import picture_to_tensor, resize_picture, tensor_to_picture, through_jpeg

QUALITIES = (95.0, 75.0, 50.0, 25.0, 10.0)
FACTORS = (1.25, 1.5, 2.0, 3.0, 4.0)


def jpeg(target: Target, quality: float) -> Target:
    """Compress the cover's pictures as JPEG of this quality; this affects only messages that are read from them."""
    return replace(
        target, on_pictures=lambda picture: picture_to_tensor(through_jpeg(tensor_to_picture(picture), int(quality)))
    )


def resizing(target: Target, factor: float) -> Target:
    """Shrink the cover's pictures by this factor and enlarge them to their original size again."""
    return replace(target, on_pictures=lambda picture: _through_smaller(picture, factor))


def _through_smaller(picture: Float[Tensor, "H W 3"], factor: float) -> Float[Tensor, "H W 3"]:
    height, width = picture.shape[:2]
    smaller = resize_picture(tensor_to_picture(picture), max(1, round(width / factor)), max(1, round(height / factor)))
    return picture_to_tensor(resize_picture(smaller, width, height))
