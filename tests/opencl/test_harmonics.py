"""Colours from spherical harmonics, against the harmonics in plain torch and against finite differences."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.device import choose_device
from opencl.harmonics import _Colors, colors_of_harmonics
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC, harmonics

CENTRE = (0.3, -0.2, -1.5)


def inputs(count: int, others: int = 15, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(count)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator).to(dtype)

    centre = torch.tensor(CENTRE, dtype=dtype)
    return random(count, 3), 0.5 * random(count, others, 3), random(count, 3), centre


def oracle(base: Tensor, rest: Tensor, means: Tensor, centre: Tensor, degree: int) -> Tensor:
    """The formula in plain torch, with its gradient by autograd."""
    values = harmonics(torch.nn.functional.normalize(means - centre, dim=-1), degree)
    coefficients = torch.cat([base[:, None], rest], dim=1)[:, : values.shape[1]]
    return (torch.einsum("nk,nkc->nc", values, coefficients) + 0.5).clamp_min(0)


def gradients(colors: Tensor, leaves: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    weights = torch.randn(colors.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    found = torch.autograd.grad(colors, leaves, weights.to(colors.dtype), allow_unused=True)
    return tuple(torch.zeros_like(leaf) if each is None else each for leaf, each in zip(leaves, found, strict=True))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 300])
def test_agrees_with_the_formula(count: int, degree: int, dtype: torch.dtype) -> None:
    base, rest, means, centre = inputs(count, dtype=dtype)
    leaves = tuple(tensor.requires_grad_() for tensor in (base, rest, means))
    found, expected = (draw(*leaves, centre, degree) for draw in (colors_of_harmonics, oracle))
    accuracy = 1e-12 if dtype == torch.float64 else 5e-6
    torch.testing.assert_close(found, expected, rtol=accuracy, atol=accuracy)
    for one, other in zip(gradients(found, leaves), gradients(expected, leaves), strict=True):
        torch.testing.assert_close(one, other, rtol=accuracy, atol=4 * accuracy)
    assert count == 1 or bool((found == 0).any())  # some are clamped


def test_the_gpu_schedule_gives_the_same() -> None:
    base, rest, means, centre = inputs(300)
    leaves = tuple(tensor.requires_grad_() for tensor in (base, rest, means))
    expected = colors_of_harmonics(*leaves, centre, 3)
    found = _Colors.apply(Backend(choose_device(), schedule="gpu"), 3, *leaves, centre)
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=1e-14)
    for one, other in zip(gradients(found, leaves), gradients(expected, leaves), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-13, atol=1e-14)


def test_gradients_of_every_input() -> None:
    base, rest, means, centre = inputs(6)
    leaves = tuple(tensor.requires_grad_() for tensor in (2 + base, rest, means))  # far from the clamp
    assert bool((colors_of_harmonics(*leaves, centre, 3) > 0.1).all())
    assert torch.autograd.gradcheck(lambda *tensors: colors_of_harmonics(*tensors, centre, 3), leaves)


def test_a_constant_color_is_the_same_from_everywhere() -> None:
    color = torch.tensor([[0.2, 0.5, 0.9]])
    for centre in torch.eye(3):
        seen = colors_of_harmonics(
            (color - 0.5) / CONSTANT_HARMONIC, torch.zeros(1, 15, 3), torch.zeros(1, 3), centre, 3
        )
        torch.testing.assert_close(seen, color)


def test_fewer_harmonics_are_enough_for_a_lower_degree() -> None:
    base, rest, means, centre = inputs(20)
    short = colors_of_harmonics(base, rest[:, :3], means, centre, 1)
    assert torch.equal(short, colors_of_harmonics(base, rest, means, centre, 1))
    assert colors_of_harmonics(base, rest[:, :0], means, centre, 0).shape == (20, 3)


def test_no_gaussians() -> None:
    base, rest, means, centre = inputs(0)
    colors = colors_of_harmonics(base.requires_grad_(), rest, means, centre, 3)
    assert colors.shape == (0, 3)
    assert gradients(colors, (base,))[0].shape == (0, 3)


def test_a_gaussian_that_is_not_finite_spoils_no_other() -> None:
    base, rest, means, centre = inputs(4)
    means[2] = float("nan")
    rest.requires_grad_()
    colors = colors_of_harmonics(base, rest, means, centre, 3)
    assert bool(colors[2].isnan().all())
    assert bool(colors[[0, 1, 3]].isfinite().all())
    (gradient,) = torch.autograd.grad(colors, rest, torch.ones_like(colors))
    assert bool(gradient.isfinite().all())


def test_the_same_bits_every_time() -> None:
    base, rest, means, centre = inputs(1000, dtype=torch.float32)
    leaves = tuple(tensor.requires_grad_() for tensor in (base, rest, means))
    runs = []
    for _ in range(20):
        colors = colors_of_harmonics(*leaves, centre, 3)
        runs.append((colors, *gradients(colors, leaves)))
    assert all(torch.equal(one, other) for run in runs for one, other in zip(run, runs[0], strict=True))


def test_a_gradient_that_torch_negates_lazily() -> None:
    leaves = [tensor.requires_grad_() for tensor in (torch.rand(4, 3), torch.rand(4, 15, 3), torch.rand(4, 3))]
    colors = colors_of_harmonics(*leaves, torch.zeros(3), 3)
    upstream = torch.rand(4, 3)
    found = torch.autograd.grad(colors, leaves, torch._neg_view(upstream), retain_graph=True)
    for one, other in zip(found, torch.autograd.grad(colors, leaves, -upstream), strict=True):
        assert torch.equal(one, other)


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": torch.zeros(4, 2)}, r"base: found shape \(4, 2\), expected \(4, 3\)"),
        ({"camera_centre": torch.zeros(2)}, "camera_centre: found shape"),
        ({"rest": torch.zeros(3, 15, 3)}, r"rest: found shape \(3, 15, 3\), expected \(4, K, 3\)"),
        ({"degree": 4}, "degree: found 4"),
        ({"degree": 2.0}, "degree: found 2.0"),
        ({"degree": True}, "degree: found True"),
        ({"rest": torch.zeros(4, 3, 3), "degree": 2}, "K = 3 harmonics"),
        ({"rest": torch.zeros(4, 15, 3, dtype=torch.float64)}, "rest: found torch.float64"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict, message: str) -> None:
    fitting = {"base": torch.zeros(4, 3), "rest": torch.zeros(4, 15, 3), "means": torch.ones(4, 3)}
    with pytest.raises(ValueError, match=message):
        colors_of_harmonics(**(fitting | {"camera_centre": torch.zeros(3), "degree": 3} | changes))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_channel_that_begins_black_can_be_told_to_rise(dtype: torch.dtype) -> None:
    """0.5 and the constant term cancel to slightly more or less than zero; neither may stop the gradient."""
    means = torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=dtype)
    base = ((torch.zeros(500, 3, dtype=dtype) - 0.5) / CONSTANT_HARMONIC).requires_grad_()
    rest = torch.zeros(500, 15, 3, dtype=dtype)
    colors_of_harmonics(base, rest, means, torch.zeros(3, dtype=dtype), 3).sum().backward()
    assert base.grad is not None
    assert (base.grad > 0).all()


def test_a_channel_well_under_zero_passes_nothing_on() -> None:
    base = torch.full((4, 3), -0.6 / CONSTANT_HARMONIC).requires_grad_()
    colors_of_harmonics(base, torch.zeros(4, 15, 3), torch.randn(4, 3), torch.zeros(3), 3).sum().backward()
    assert base.grad is not None
    assert (base.grad == 0).all()
