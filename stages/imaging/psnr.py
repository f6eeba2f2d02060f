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
    """PSNR in decibels for a peak of 1: ``-10 log10`` of the mean squared error, in float64.

    The picture is clamped to [0, 1] first. The mean is over all pixels and channels, or over the pixels where ``mask``
    is true. Equal pictures give infinity. The result is NaN if there are no pixels to compare, or if one of them is NaN
    because rendering failed. Raises ``ValueError`` if shapes differ.
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
