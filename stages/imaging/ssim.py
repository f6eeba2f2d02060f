"""Structural similarity (Wang et al., 2004) as 3D Gaussian Splatting uses it.

An 11 x 11 Gaussian window of sigma 1.5, zero padding at the borders, constants 0.01² and 0.03² for a peak of 1; the
mean is over all pixels and channels. A training step needs the mean and its gradient several times, so ``ssim`` uses
the rasterizer's fused kernel. ``ssim_map``, for evaluation over part of a picture, is the same formula in torch.
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

    Colours are in [0, 1], float32 or float64; the gradient reaches `picture`. The result does not depend on the number
    of threads (on the CPU, up to 2000 x 1360 pixels). Raises ``ValueError`` if the pictures are empty or differ in
    shape, type or device, or if `truth` requires a gradient.
    """
    return mean_ssim(picture, truth)


def ssim_map(
    picture: Float[Tensor, "*batch height width 3"], truth: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """The structural similarity at each pixel and channel; ``ssim`` is its mean.

    Raises ``ValueError`` if the pictures differ in shape, type or device.
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
    """Gaussian-weighted mean over the window at each pixel, with zeros beyond the borders.

    Computed as eleven shifted additions per axis: element-wise sums do not depend on the number of threads.
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
