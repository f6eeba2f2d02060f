"""Structural similarity (Wang et al., 2004) as 3D Gaussian Splatting uses it, with its gradient in closed form.

An 11 x 11 Gaussian window of sigma 1.5, zero padding at the borders, constants 0.01² and 0.03² for a peak of 1; the
mean runs over all pixels and channels. A training step computes it several times, so it is made for speed: the window
is separable, the two variances are only needed as a sum, and the gradient is again three such blurs.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

REACH = 5
SIGMA = 1.5
LUMINANCE_CONSTANT = 0.01**2
CONTRAST_CONSTANT = 0.03**2


def ssim(picture: Float[Tensor, "*batch height width 3"], truth: Float[Tensor, "*batch height width 3"]) -> Tensor:
    """The mean structural similarity, a scalar in [-1, 1]; 1 for equal pictures.

    Colours in [0, 1], float32 or float64, and differentiable with respect to both pictures. Raises ``ValueError`` if
    their shapes, types or devices differ.
    """
    return ssim_map(picture, truth).mean()


def ssim_map(
    picture: Float[Tensor, "*batch height width 3"], truth: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """The structural similarity about each pixel, for each channel; ``ssim`` is its mean."""
    if picture.shape != truth.shape or picture.dtype != truth.dtype or picture.device != truth.device:
        described = [f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}" for tensor in (picture, truth)]
        raise ValueError(f"two pictures to compare must be alike in shape, type and device, not {described}")
    result: Tensor = _SsimMap.apply(picture, truth)
    return result


class _SsimMap(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, picture: Tensor, truth: Tensor) -> Tensor:
        means, mean_product, mean_squares = _moments(picture, truth)
        product_of_means = means[0] * means[1]
        sum_of_squared_means = means[0].square().addcmul_(means[1], means[1])
        luminance = 2 * product_of_means + LUMINANCE_CONSTANT
        contrast = 2 * (mean_product - product_of_means) + CONTRAST_CONSTANT
        luminance_scale = sum_of_squared_means + LUMINANCE_CONSTANT
        contrast_scale = mean_squares - sum_of_squared_means + CONTRAST_CONSTANT
        scale = luminance_scale * contrast_scale
        similarity = luminance * contrast / scale
        if any(context.needs_input_grad):
            by_product = 2 * luminance / scale
            by_squares = -similarity / contrast_scale
            crossed = 2 * (contrast - luminance) / scale
            own = 2 * similarity * (luminance_scale - contrast_scale) / scale
            context.save_for_backward(picture, truth, means, by_product, by_squares, crossed, own)
        return similarity

    @staticmethod
    @once_differentiable
    def backward(context: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None]:
        picture, truth, means, by_product, by_squares, crossed, own = context.saved_tensors
        # The window is symmetric and the padding zero, so blurring is its own adjoint.
        through_product, through_squares = blur(torch.stack((gradient * by_product, gradient * by_squares)))

        def gradient_of(one: Tensor, other: Tensor, mean: Tensor, other_mean: Tensor) -> Tensor:
            through_mean = blur(gradient * (crossed * other_mean + own * mean))
            return through_mean.addcmul_(through_product, other).addcmul_(through_squares, one, value=2)

        for_picture, for_truth = context.needs_input_grad
        return (
            gradient_of(picture, truth, means[0], means[1]) if for_picture else None,
            gradient_of(truth, picture, means[1], means[0]) if for_truth else None,
        )


def _moments(picture: Tensor, truth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Windowed means of both pictures (stacked), of their product, and of the sum of their squares."""
    fields = picture.new_empty((4, *picture.shape))
    fields[0].copy_(picture)
    fields[1].copy_(truth)
    torch.mul(picture, truth, out=fields[2])
    torch.mul(picture, picture, out=fields[3]).addcmul_(truth, truth)
    blurred = blur(fields)
    return blurred[:2], blurred[2], blurred[3]


def blur(fields: Float[Tensor, "*batch height width channels"]) -> Float[Tensor, "*batch height width channels"]:
    """The window's weighted mean about every pixel, with zeros beyond the borders.

    Eleven shifted additions an axis: memory-bound on contiguous rows, it beats every convolution of torch on CPUs
    (depthwise, separable or as a matrix product), and element-wise sums give the same bits for any number of threads.
    """
    return _blur_axis(_blur_axis(fields, -3), -2)


def _blur_axis(fields: Tensor, axis: int) -> Tensor:
    length = fields.shape[axis]
    padding = [0, 0] * (-axis - 1) + [REACH, REACH]
    padded = torch.nn.functional.pad(fields, padding)
    weights = _window()
    result = padded.narrow(axis, 0, length) * weights[0]
    for offset, weight in enumerate(weights[1:], start=1):
        result.add_(padded.narrow(axis, offset, length), alpha=weight)
    return result


def _window() -> list[float]:
    weights = [math.exp(-(offset**2) / (2 * SIGMA**2)) for offset in range(-REACH, REACH + 1)]
    return [weight / sum(weights) for weight in weights]
