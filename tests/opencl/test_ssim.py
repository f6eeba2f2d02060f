"""The fused structural similarity against its definition in plain torch, and its gradient against autograd's."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.device import choose_device
from opencl.ssim import _MeanSsim, mean_ssim
from stages.imaging.ssim import ssim_map

SHAPES = [(1, 1), (5, 200), (37, 3), (13, 17), (20, 86), (6, 171), (2, 3, 12, 14)]
"""Rows slightly longer than one and than two strips (256 values), sides smaller than the window, several pictures."""


def pair(*shape: int, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(sum(shape))
    picture, noise = (torch.rand(*shape, 3, dtype=torch.float64, generator=generator) for _ in range(2))
    return (1.2 * picture - 0.1).to(dtype).requires_grad_(), (0.6 * picture + 0.4 * noise).to(dtype)


def value_and_gradient(similarity: Tensor, picture: Tensor) -> tuple[Tensor, Tensor]:
    return similarity.detach(), torch.autograd.grad(3 * similarity, picture)[0]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_agrees_with_the_definition(shape: tuple[int, ...]) -> None:
    picture, truth = pair(*shape)
    value, gradient = value_and_gradient(mean_ssim(picture, truth), picture)
    expected_value, expected_gradient = value_and_gradient(ssim_map(picture, truth).mean(), picture)
    torch.testing.assert_close(value, expected_value, rtol=0, atol=1e-13)
    torch.testing.assert_close(gradient, expected_gradient, rtol=1e-10, atol=1e-13)
    assert torch.equal(mean_ssim(picture.detach(), truth), value)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_float32_follows_float64(shape: tuple[int, ...]) -> None:
    picture, truth = pair(*shape)
    value, gradient = value_and_gradient(mean_ssim(picture, truth), picture)
    single = picture.detach().float().requires_grad_()
    single_value, single_gradient = value_and_gradient(mean_ssim(single, truth.float()), single)
    assert single_value.dtype == single_gradient.dtype == torch.float32
    torch.testing.assert_close(single_value.double(), value, rtol=0, atol=2e-6)
    torch.testing.assert_close(single_gradient.double(), gradient, rtol=0, atol=float(1e-5 * gradient.abs().max()))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_gpu_schedule_differs_by_rounding_only(shape: tuple[int, ...]) -> None:
    picture, truth = pair(*shape)
    value, gradient = value_and_gradient(mean_ssim(picture, truth), picture)
    on_gpu = _MeanSsim.apply(Backend(choose_device(), schedule="gpu"), picture, truth)
    gpu_value, gpu_gradient = value_and_gradient(on_gpu, picture)
    torch.testing.assert_close(gpu_value, value, rtol=0, atol=1e-14)
    torch.testing.assert_close(gpu_gradient, gradient, rtol=1e-12, atol=1e-15)


def test_gradient_against_finite_differences() -> None:
    picture, truth = pair(7, 6)
    assert torch.autograd.gradcheck(mean_ssim, (picture, truth))


def test_pictures_of_a_batch_do_not_reach_into_each_other() -> None:
    picture, truth = pair(2, 12, 14)
    together = mean_ssim(picture, truth)
    alone = torch.stack([mean_ssim(*each) for each in zip(picture, truth, strict=True)]).mean()
    torch.testing.assert_close(together, alone, rtol=0, atol=1e-14)


def test_pictures_that_do_not_lie_row_by_row() -> None:
    picture, truth = pair(9, 12)
    turned = picture.detach().transpose(0, 1)
    similarity = mean_ssim(turned, truth.transpose(0, 1))
    torch.testing.assert_close(similarity, mean_ssim(picture, truth).detach(), rtol=0, atol=1e-14)


def digest() -> list[str]:
    picture, truth = pair(40, 90, dtype=torch.float32)
    value, gradient = value_and_gradient(mean_ssim(picture, truth), picture)
    return [float(value).hex(), float(gradient.double().sum()).hex(), float(gradient.abs().max()).hex()]


def test_the_same_bits_on_every_run_and_for_any_number_of_threads() -> None:
    digests = {str(digest()) for _ in range(20)}
    for threads in ("1", "3"):
        environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": threads, "OMP_NUM_THREADS": threads}
        code = "from tests.opencl.test_ssim import digest; print(digest())"
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        digests.add(done.stdout.strip())
    assert len(digests) == 1


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("picture", "truth", "message"),
    [
        (torch.zeros(8, 8, 3), torch.zeros(8, 9, 3), "alike in shape, type and device"),
        (torch.zeros(8, 8, 3), torch.zeros(8, 8, 3, dtype=torch.float64), "alike in shape, type and device"),
        (torch.zeros(8, 8, 4), torch.zeros(8, 8, 4), r"found shape \(8, 8, 4\)"),
        (torch.zeros(8, 0, 3), torch.zeros(8, 0, 3), "not empty"),
        (torch.zeros(8, 8, 3).half(), torch.zeros(8, 8, 3).half(), "expected float32 or float64"),
        (torch.zeros(8, 8, 3), torch.zeros(8, 8, 3, requires_grad=True), "truths: found requires_grad"),
    ],
)
def test_what_does_not_fit_is_refused(picture: Tensor, truth: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mean_ssim(picture, truth)
