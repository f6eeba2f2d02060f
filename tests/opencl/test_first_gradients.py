"""Kernels compute first gradients only: second ones are refused, however they would depend on the inputs."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from opencl.convolution import convolve
from opencl.harmonics import colors_of_harmonics
from opencl.pixel_decoder import decode_pixels
from opencl.rasterizer import rasterize
from opencl.separation import separation_penalty
from opencl.ssim import mean_ssim
from tests.opencl.scenes import make_scene

Function = Callable[[Tensor], Tensor]


def random(*shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(sum(shape)))


def of_a_convolution() -> tuple[Function, Tensor]:
    weight, bias = random(16, 16, 3, 3).requires_grad_(), random(16)
    return lambda values: convolve(values, weight, bias, rectified=True), random(1, 16, 5, 6)


def of_a_pixel_decoder() -> tuple[Function, Tensor]:
    weights, biases = [random(32, 16).requires_grad_(), random(3, 32)], [random(32), random(3)]
    return lambda picture: decode_pixels(picture, weights, biases), random(7, 16)


def of_a_separation() -> tuple[Function, Tensor]:
    directions, readings = random(2, 16), random(2, 7, 16).requires_grad_()
    return lambda features: separation_penalty(features, directions, readings, 100, 60), random(9, 16)


def of_structural_similarity() -> tuple[Function, Tensor]:
    truth = random(9, 8, 3)
    return lambda picture: mean_ssim(picture, truth), truth + 0.1 * random(9, 8, 4)[..., :3]


def of_harmonics() -> tuple[Function, Tensor]:
    rest, means, centre = random(6, 15, 3).requires_grad_(), random(6, 3), random(3)
    return lambda base: colors_of_harmonics(base, rest, means, centre, 3), random(6, 3) + 2


def of_a_picture() -> tuple[Function, Tensor]:
    scene = make_scene(count=5)
    scene.features.requires_grad_()
    return lambda means: rasterize(means, *scene.gaussians[1:], *scene.camera).features, scene.means


def of_centres_on_the_screen() -> tuple[Function, Tensor]:
    scene = make_scene(count=5)
    return lambda means: rasterize(means, *scene.gaussians[1:], *scene.camera).means2d, scene.means


KERNELS = [
    of_a_convolution,
    of_a_pixel_decoder,
    of_a_separation,
    of_structural_similarity,
    of_harmonics,
    of_a_picture,
    of_centres_on_the_screen,
]
of_every_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.__name__)


@of_every_kernel
def test_second_gradients_are_refused(kernel: Callable[[], tuple[Function, Tensor]]) -> None:
    """Even for a sum, whose incoming gradient consists of ones that do not depend on the inputs."""
    function, values = kernel()
    values.requires_grad_()
    with pytest.raises(RuntimeError, match="found create_graph=True, expected none: kernels compute first gradients"):
        torch.autograd.grad(function(values).sum(), values, create_graph=True)


@of_every_kernel
def test_a_graph_that_is_kept_gives_the_same_gradient_again(kernel: Callable[[], tuple[Function, Tensor]]) -> None:
    function, values = kernel()
    values.requires_grad_()
    result = function(values).square().sum()
    first, second = (torch.autograd.grad(result, values, retain_graph=True)[0] for _ in range(2))
    assert bool(first.any())
    assert torch.equal(first, second)


@pytest.mark.parametrize("reentrant", [False, True])
@of_every_kernel
def test_checkpoints_compute_again_and_differentiate(
    kernel: Callable[[], tuple[Function, Tensor]], reentrant: bool
) -> None:
    function, values = kernel()
    found = []
    for given in (function, lambda leaf: checkpoint(function, leaf, use_reentrant=reentrant)):
        leaf = values.detach().clone().requires_grad_()
        given(leaf).square().sum().backward()
        found.append(leaf.grad)
    assert torch.equal(*found)
