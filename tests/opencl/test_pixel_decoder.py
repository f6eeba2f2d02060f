"""Pixel decoders against their definition in plain torch, and their gradients against autograd's."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from opencl import pixel_decoder
from opencl.contract import RasterSettings
from opencl.pixel_decoder import decode_pixels
from opencl.program import ProgramKey
from tests.opencl.differentiated import with_gradients
from tests.opencl.runtimes import bits, printed_with_threads

WIDTHS = [(3, 5), (16, 32, 3), (24, 32, 32, 6), (1, 17, 48, 16, 2)]
"""Channels of the input and of each layer: fewer than sixteen, exactly sixteen, and more."""


def decoder(pixels: int, *widths: int) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """A row of pixels, weights and biases, in float64 and with gradients."""
    generator = torch.Generator().manual_seed(pixels + sum(widths))

    def leaf(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator).requires_grad_()

    layers = list(pairwise(widths))
    return leaf(pixels, widths[0]), [leaf(out, into) for into, out in layers], [leaf(out) for _, out in layers]


def expected(picture: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor]) -> Tensor:
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        picture = torch.nn.functional.linear(picture.relu() if number else picture, weight, bias)
    return picture


def listed(picture: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor]) -> list[Tensor]:
    """All tensors that have a gradient."""
    return [picture, *weights, *biases]


def check(pixels: int, *widths: int) -> None:
    leaves = decoder(pixels, *widths)
    found = with_gradients(decode_pixels(*leaves), listed(*leaves))
    for one, other in zip(found, with_gradients(expected(*leaves), listed(*leaves)), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("pixels", [1, 31, 32, 33, 700])
@pytest.mark.parametrize("widths", WIDTHS, ids=str)
def test_it_is_its_layers(pixels: int, widths: tuple[int, ...]) -> None:
    check(pixels, *widths)


@given(pixels=st.integers(1, 90), widths=st.lists(st.integers(1, 40), min_size=2, max_size=5))
def test_of_any_size(pixels: int, widths: list[int]) -> None:
    check(pixels, *widths)


def test_gradients_against_finite_differences() -> None:
    picture, weights, biases = decoder(3, 4, 17, 2)

    def function(picture: Tensor, *parameters: Tensor) -> Tensor:
        return decode_pixels(picture, parameters[:2], parameters[2:])

    assert torch.autograd.gradcheck(function, (picture, *weights, *biases), fast_mode=True)


def test_float32_rounds_little() -> None:
    leaves = decoder(5000, 16, 32, 32, 3)
    picture, weights, biases = leaves
    single = (
        picture.detach().float().requires_grad_(),
        [weight.detach().float().requires_grad_() for weight in weights],
        [bias.detach().float().requires_grad_() for bias in biases],
    )
    found = with_gradients(decode_pixels(*single), listed(*single))
    for one, other in zip(found, with_gradients(expected(*leaves), listed(*leaves)), strict=True):
        assert one.dtype == torch.float32
        assert float((one - other).norm() / other.norm()) < 1e-5


def test_a_processor_with_narrow_registers_computes_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    leaves = decoder(70, 20, 32, 6)
    usual = with_gradients(decode_pixels(*leaves), listed(*leaves))
    narrow = ProgramKey("pixel_decoder", "cpu", torch.float64, RasterSettings())
    monkeypatch.setattr(pixel_decoder, "product_program", lambda *_: narrow)
    for one, other in zip(with_gradients(decode_pixels(*leaves), listed(*leaves)), usual, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("items", [1, 3, 22])
def test_who_takes_which_pixels_does_not_matter(monkeypatch: pytest.MonkeyPatch, items: int) -> None:
    """The results are the same to the last bit."""
    leaves = decoder(700, 16, 32, 3)
    usual = with_gradients(decode_pixels(*leaves), listed(*leaves))
    monkeypatch.setattr(pixel_decoder, "work_items", lambda backend, chunks: items)
    for one, other in zip(with_gradients(decode_pixels(*leaves), listed(*leaves)), usual, strict=True):
        assert bits(one) == bits(other)


def test_a_picture_keeps_its_shape_however_it_lies() -> None:
    row, weights, biases = decoder(30, 16, 32, 3)
    picture = row.detach().view(5, 6, 16)
    across = picture.transpose(0, 1)
    shown = decode_pixels(picture, weights, biases)
    assert shown.shape == (5, 6, 3)
    assert torch.equal(decode_pixels(across, weights, biases), shown.transpose(0, 1))


def test_only_what_is_asked_for_has_a_gradient() -> None:
    picture, weights, biases = decoder(700, 16, 32, 3)
    all_of_them = with_gradients(decode_pixels(picture, weights, biases), listed(picture, weights, biases))[1:]
    frozen = [[tensor.detach() for tensor in each] for each in (weights, biases)]
    (of_picture,) = with_gradients(decode_pixels(picture, *frozen), [picture])[1:]
    of_weights = with_gradients(decode_pixels(picture.detach(), weights, biases), [*weights, *biases])[1:]
    for one, other in zip([of_picture, *of_weights], all_of_them, strict=True):
        assert bits(one) == bits(other)
    of_one_bias = with_gradients(decode_pixels(picture.detach(), frozen[0], [frozen[1][0], biases[1]]), [biases[1]])[1]
    assert bits(of_one_bias) == bits(all_of_them[-1])


def test_what_nobody_asks_for_is_not_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """No memory is allocated for it."""
    rooms: list[list[bool]] = []
    launch = pixel_decoder._Work.launch

    def noted(work: pixel_decoder._Work, *given: Any, results: tuple[Tensor, ...]) -> None:
        rooms.append([result.numel() > 0 for result in results])
        launch(work, *given, results=results)

    monkeypatch.setattr(pixel_decoder._Work, "launch", noted)
    picture, weights, biases = decoder(40, 16, 32, 3)
    decode_pixels(picture.detach(), weights, biases).sum().backward()
    decode_pixels(picture, [each.detach() for each in weights], [each.detach() for each in biases]).sum().backward()
    assert rooms == [[True], [False, True], [True], [True, False]]


def test_what_torch_negates_lazily() -> None:
    picture, weights, biases = decoder(40, 16, 32, 3)
    negated = [torch._neg_view(picture), [torch._neg_view(each) for each in weights], biases]
    negative = [-picture, [-each for each in weights], biases]
    decoded, again = decode_pixels(*negated), decode_pixels(*negative)
    assert torch.equal(decoded, again)
    upstream = torch.ones_like(decoded)
    leaves = listed(picture, weights, biases)
    found = torch.autograd.grad(decoded, leaves, torch._neg_view(upstream))
    for one, other in zip(found, torch.autograd.grad(again, leaves, -upstream), strict=True):
        assert torch.equal(one, other)


def test_no_pixels_give_none() -> None:
    picture, weights, biases = decoder(0, 16, 32, 3)
    assert decode_pixels(picture.view(0, 4, 16), weights, biases).shape == (0, 4, 3)
    shown, *gradients = with_gradients(decode_pixels(picture, weights, biases), listed(picture, weights, biases))
    assert shown.shape == (0, 3)
    assert not any(gradient.any() for gradient in gradients)


def test_what_is_not_a_number_stays_one() -> None:
    picture, weights, biases = decoder(40, 16, 32, 3)
    broken = picture.detach().clone()
    broken[33, 2] = torch.nan
    shown = decode_pixels(broken, weights, biases)
    assert shown[33].isnan().all()
    assert not shown[:33].isnan().any()


BITS = """
import torch
from tests.opencl.differentiated import with_gradients
from tests.opencl.test_pixel_decoder import decoder, listed
from opencl.pixel_decoder import decode_pixels
single = lambda tensor: tensor.detach().float().requires_grad_()
picture, weights, biases = decoder(3000, 16, 32, 32, 3)
leaves = single(picture), list(map(single, weights)), list(map(single, biases))
found = with_gradients(decode_pixels(*leaves), listed(*leaves))
print([hash(tensor.contiguous().numpy().tobytes()) for tensor in found])
"""


def test_the_same_bits_with_any_number_of_threads() -> None:
    assert printed_with_threads(BITS, 1) == printed_with_threads(BITS, 2)


def test_what_does_not_fit_is_refused() -> None:
    picture, weights, biases = decoder(4, 16, 32, 3)
    for wrong in (
        (picture, [], []),
        (picture, weights, biases[:1]),
        (picture, weights[::-1], biases),
        (picture, weights, biases[::-1]),
        (picture[:, :9], weights, biases),
        (picture[:, :0], [weights[0][:, :0], weights[1]], biases),
        (picture, [weights[0], weights[1][:0]], [biases[0], biases[1][:0]]),
    ):
        with pytest.raises(ValueError, match="expected channels, then weights and biases"):
            decode_pixels(*wrong)
    with pytest.raises(ValueError, match="expected float32 or float64 of a CPU"):
        decode_pixels(picture.float(), weights, biases)
    halves = [[tensor.bfloat16() for tensor in each] for each in (weights, biases)]
    with pytest.raises(ValueError, match="expected float32 or float64 of a CPU"):
        decode_pixels(picture.bfloat16(), *halves)
