"""Structural similarity (Wang et al., 2004) as 3D Gaussian Splatting uses it.

An 11 x 11 Gaussian window of sigma 1.5, zero padding at the borders, constants 0.01² and 0.03² for a peak of 1; the
mean runs over all pixels and channels. A training step computes the mean several times, with its gradient: that is the
rasterizer's fused kernel. The map, of which evaluation needs a part, is the same formula in torch.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.ssim import mean_ssim

REACH = 5
SIGMA = 1.5
LUMINANCE_CONSTANT = 0.01**2
CONTRAST_CONSTANT = 0.03**2


def ssim(picture: Float[Tensor, "*batch height width 3"], truth: Float[Tensor, "*batch height width 3"]) -> Tensor:
    """The mean structural similarity, a scalar in [-1, 1]; 1 for equal pictures.

    Colours in [0, 1], float32 or float64; the gradient reaches `picture`. The same bits for any number of threads.
    Raises ``ValueError`` if the pictures' shapes, types or devices differ, or if `truth` asks for a gradient.
    """
    return mean_ssim(picture, truth)


def ssim_map(
    picture: Float[Tensor, "*batch height width 3"], truth: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """The structural similarity about each pixel, for each channel; ``ssim`` is its mean.

    Raises ``ValueError`` as ``ssim`` does for pictures that are not alike.
    """
    if picture.shape != truth.shape or picture.dtype != truth.dtype or picture.device != truth.device:
        described = [f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}" for tensor in (picture, truth)]
        raise ValueError(f"two pictures to compare must be alike in shape, type and device, not {described}")
    mean, mean_of_truth = blur(picture), blur(truth)
    product_of_means, squares_of_means = mean * mean_of_truth, mean.square() + mean_of_truth.square()
    luminance = (2 * product_of_means + LUMINANCE_CONSTANT) / (squares_of_means + LUMINANCE_CONSTANT)
    covariance = blur(picture * truth) - product_of_means
    variances = blur(picture.square() + truth.square()) - squares_of_means
    return luminance * (2 * covariance + CONTRAST_CONSTANT) / (variances + CONTRAST_CONSTANT)


def blur(fields: Float[Tensor, "*batch height width channels"]) -> Float[Tensor, "*batch height width channels"]:
    """The window's weighted mean about every pixel, with zeros beyond the borders.

    Eleven shifted additions an axis: element-wise sums give the same bits for any number of threads.
    """
    return _blur_axis(_blur_axis(fields, -3), -2)


def _blur_axis(fields: Tensor, axis: int) -> Tensor:
    length = fields.shape[axis]
    padding = [0, 0] * (-axis - 1) + [REACH, REACH]
    padded = torch.nn.functional.pad(fields, padding)
    first, *others = (padded.narrow(axis, offset, length) * weight for offset, weight in enumerate(_window()))
    return sum(others, first)


def _window() -> list[float]:
    weights = [math.exp(-(offset**2) / (2 * SIGMA**2)) for offset in range(-REACH, REACH + 1)]
    return [weight / sum(weights) for weight in weights]
