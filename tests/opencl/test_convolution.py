"""Convolutions by Winograd's filtering against torch's own, and their gradients against autograd's."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.nn.functional import conv2d

from opencl import convolution
from opencl.contract import RasterSettings
from opencl.convolution import can_convolve, convolve
from opencl.program import ProgramKey
from tests.opencl.differentiated import with_gradients
from tests.opencl.runtimes import bits, printed_with_threads

SHAPES = [
    (1, 16, 16, 1, 1),
    (1, 16, 32, 4, 4),
    (1, 32, 16, 5, 7),
    (2, 16, 48, 3, 10),
    (3, 48, 16, 9, 4),
    (1, 64, 64, 33, 40),
    (2, 16, 32, 61, 47),
]
"""(Pictures, channels in and out, height, width): less than a tile, tiles that extend beyond the picture, several
chunks, and several chunks for each work-item."""


def inputs(pictures: int, channels: int, outputs: int, height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    """Values, weight and bias, in float64 and with gradients."""
    generator = torch.Generator().manual_seed(channels + outputs + height + width)
    shapes = [(pictures, channels, height, width), (outputs, channels, 3, 3), (outputs,)]
    values, weight, bias = (torch.randn(*shape, dtype=torch.float64, generator=generator) for shape in shapes)
    return values.requires_grad_(), weight.requires_grad_(), bias.requires_grad_()


def expected(values: Tensor, weight: Tensor, bias: Tensor, rectified: bool) -> Tensor:
    convolved = conv2d(values, weight, bias, padding=1)
    return convolved.relu() if rectified else convolved


@pytest.mark.parametrize("rectified", [False, True])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_it_is_torchs_convolution(shape: tuple[int, int, int, int, int], rectified: bool) -> None:
    leaves = inputs(*shape)
    found = with_gradients(convolve(*leaves, rectified), leaves)
    for one, other in zip(found, with_gradients(expected(*leaves, rectified), leaves), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-11)


@given(
    pictures=st.integers(1, 3),
    channels=st.sampled_from([16, 32]),
    outputs=st.sampled_from([16, 32]),
    height=st.integers(1, 21),
    width=st.integers(1, 21),
)
def test_of_any_size(pictures: int, channels: int, outputs: int, height: int, width: int) -> None:
    leaves = inputs(pictures, channels, outputs, height, width)
    found = with_gradients(convolve(*leaves, True), leaves)
    for one, other in zip(found, with_gradients(expected(*leaves, True), leaves), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-10)


def test_gradients_against_finite_differences() -> None:
    values, weight, bias = inputs(1, 16, 16, 3, 2)
    assert torch.autograd.gradcheck(convolve, (values, weight, bias + 0.5, True), fast_mode=True)


@pytest.mark.parametrize("rectified", [False, True])
def test_float32_rounds_little(rectified: bool) -> None:
    """The relative error of results and gradients is below 1e-5."""
    leaves = inputs(1, 64, 64, 50, 28)
    single = [tensor.detach().float().requires_grad_() for tensor in leaves]
    found = with_gradients(convolve(*single, rectified), single)
    for one, other in zip(found, with_gradients(expected(*leaves, rectified), leaves), strict=True):
        assert one.dtype == torch.float32
        assert float((one - other).norm() / other.norm()) < 1e-5


def test_a_processor_with_narrow_registers_computes_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    leaves = inputs(2, 32, 48, 11, 14)
    usual = with_gradients(convolve(*leaves), leaves)
    narrow = ProgramKey("convolution", "cpu", torch.float64, RasterSettings())
    monkeypatch.setattr(convolution, "product_program", lambda *_: narrow)
    for one, other in zip(with_gradients(convolve(*leaves), leaves), usual, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("items", [1, 3, 24])
def test_who_takes_which_tiles_does_not_matter(monkeypatch: pytest.MonkeyPatch, items: int) -> None:
    """To the last bit. The gradient of the weights is always the sum of the same number of parts, so it is included."""
    leaves = inputs(2, 16, 32, 61, 47)
    usual = with_gradients(convolve(*leaves, True), leaves)
    monkeypatch.setattr(convolution, "work_items", lambda backend, chunks: items)
    for one, other in zip(with_gradients(convolve(*leaves, True), leaves), usual, strict=True):
        assert bits(one) == bits(other)


def test_values_that_are_not_channels_last() -> None:
    values, weight, bias = inputs(2, 16, 32, 6, 9)
    last = values.detach().to(memory_format=torch.channels_last)
    crossed = values.detach().transpose(2, 3).contiguous().transpose(2, 3)
    assert torch.equal(convolve(last, weight, bias), convolve(values.detach(), weight, bias))
    assert torch.equal(convolve(crossed, weight, bias), convolve(values.detach(), weight, bias))
    assert convolve(last, weight, bias).is_contiguous(memory_format=torch.channels_last)


def test_pictures_may_be_changed_in_place() -> None:
    leaves = inputs(2, 16, 32, 6, 9)
    found = with_gradients(convolve(*leaves).clamp_(0, 1), leaves)
    for one, other in zip(found, with_gradients(expected(*leaves, False).clamp_(0, 1), leaves), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("way", [convolve, expected])
def test_what_a_relu_keeps_for_the_gradient_may_not_be(way: Callable[..., Tensor]) -> None:
    values, weight, bias = inputs(1, 16, 16, 4, 4)
    changed = way(values, weight, bias, True).clamp_(0, 1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        changed.sum().backward()


def test_what_torch_negates_lazily() -> None:
    leaves = inputs(1, 16, 32, 6, 9)
    pictures, *gradients = with_gradients(convolve(*(torch._neg_view(leaf) for leaf in leaves)), leaves)
    expected_pictures, *expected_gradients = with_gradients(convolve(*(-leaf for leaf in leaves)), leaves)
    assert torch.equal(pictures, expected_pictures)
    assert all(torch.equal(one, other) for one, other in zip(gradients, expected_gradients, strict=True))
    upstream = torch.ones_like(pictures)
    of_negated, of_negative = (
        torch.autograd.grad(convolve(*leaves), leaves, given) for given in (torch._neg_view(upstream), -upstream)
    )
    assert all(torch.equal(one, other) for one, other in zip(of_negated, of_negative, strict=True))


def test_only_what_is_asked_for_has_a_gradient() -> None:
    values, weight, bias = inputs(1, 16, 16, 5, 6)
    convolve(values, weight.detach(), bias.detach()).sum().backward()
    assert (values.grad is None, weight.grad is None, bias.grad is None) == (False, True, True)
    convolve(values.detach(), weight, bias).sum().backward()
    assert weight.grad is not None
    assert bias.grad is not None
    assert bias.grad.untyped_storage().nbytes() == bias.nbytes
    assert not convolve(values.detach(), weight.detach(), bias.detach()).requires_grad


def test_what_is_not_a_number_stays_one() -> None:
    """The result is NaN wherever torch's is, and otherwise only in the 4 x 4 tile that reads the value."""
    values, weight, bias = (tensor.detach() for tensor in inputs(1, 16, 16, 12, 12))
    values[0, 3, 5, 5] = torch.nan
    lost = convolve(values, weight, bias, True).isnan()
    assert bool(lost[expected(values, weight, bias, True).isnan()].all())
    lost[..., 4:8, 4:8] = False
    assert not bool(lost.any())


BITS = """
import torch
from tests.opencl.differentiated import with_gradients
from tests.opencl.test_convolution import inputs
from opencl.convolution import convolve
leaves = [tensor.detach().float().requires_grad_() for tensor in inputs(1, 32, 32, 70, 45)]
print([tensor.contiguous().numpy().tobytes().__hash__() for tensor in with_gradients(convolve(*leaves, True), leaves)])
"""


def test_the_same_bits_with_any_number_of_threads() -> None:
    assert printed_with_threads(BITS, 1) == printed_with_threads(BITS, 2)


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_autocast_changes_nothing(half: torch.dtype) -> None:
    """Kernels read weights of the type that they are compiled for, whatever torch makes of its own products."""
    leaves = [tensor.detach().float().requires_grad_() for tensor in inputs(1, 16, 32, 9, 6)]
    expected = with_gradients(convolve(*leaves), leaves)
    with torch.autocast("cpu", dtype=half):
        found = with_gradients(convolve(*leaves), leaves)
    assert [*map(bits, found)] == [*map(bits, expected)]


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("values", "weight", "takes"),
    [
        (torch.zeros(1, 16, 4, 4), torch.zeros(32, 16, 3, 3), True),
        (torch.zeros(1, 16, 4, 4).double(), torch.zeros(32, 16, 3, 3).double(), True),
        (torch.zeros(1, 16, 4, 4).double(), torch.zeros(32, 16, 3, 3), False),
        (torch.zeros(1, 16, 4, 4).bfloat16(), torch.zeros(32, 16, 3, 3).bfloat16(), False),
        (torch.zeros(1, 16, 4, 4), torch.zeros(3, 16, 3, 3), False),
        (torch.zeros(1, 5, 4, 4), torch.zeros(16, 5, 3, 3), False),
        (torch.zeros(1, 16, 4, 4), torch.zeros(32, 16, 1, 1), False),
        (torch.zeros(0, 16, 4, 4), torch.zeros(32, 16, 3, 3), False),
        (torch.zeros(16, 4, 4), torch.zeros(32, 16, 3, 3), False),
        (torch.zeros(1, 16, 4, 4, device="meta"), torch.zeros(32, 16, 3, 3, device="meta"), False),
    ],
)
def test_what_it_takes(values: Tensor, weight: Tensor, takes: bool) -> None:
    assert can_convolve(values, weight) is takes
    if not takes:
        with pytest.raises(ValueError, match=r"expected values \(B, C, H, W\)"):
            convolve(values, weight, weight.new_zeros(len(weight)))


@pytest.mark.usefixtures("any_arrays")
def test_channels_and_a_bias_that_do_not_fit_are_refused() -> None:
    values, weight, bias = inputs(1, 16, 32, 4, 4)
    with pytest.raises(ValueError, match=r"found \['\(1, 16, 4, 4\)"):
        convolve(values, torch.cat([weight, weight], dim=1), bias)
    for wrong in (bias[:16], bias.float(), bias.to("meta")):
        with pytest.raises(ValueError, match="a bias"):
            convolve(values, weight, wrong)
