"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math

from jaxtyping import Bool, Float
from torch import Tensor


def psnr(
    picture: Float[Tensor, "*batch height width 3"],
    truth: Float[Tensor, "*batch height width 3"],
    mask: Bool[Tensor, "*batch height width"] | None = None,
) -> float:
    """``-10 log10`` of the mean squared error in decibels, the peak being 1; the picture is clamped to [0, 1] first.

    The mean runs over every pixel and channel, or over those pixels where ``mask`` is true. Equal pictures give
    infinity; a mask without a pixel gives NaN, since there is nothing to measure, and so does a picture with NaN among
    these pixels, whose rendering failed. Sums run in float64.
    Raises ``ValueError`` if shapes differ.
    """
    if picture.shape != truth.shape or (mask is not None and mask.shape != picture.shape[:-1]):
        shapes = [tuple(tensor.shape) for tensor in (picture, truth, mask) if tensor is not None]
        raise ValueError(f"picture, truth and mask must have one size, not {shapes}")
    squared_error = (picture.detach().clamp(0, 1).double() - truth.detach().double()).square()
    if mask is not None:
        squared_error = squared_error[mask]
    if squared_error.numel() == 0:
        return math.nan
    mean = float(squared_error.mean())
    return math.inf if mean == 0 else -10 * math.log10(mean)
