"""Decoders: their layers and precision. Processors without bfloat16 instructions round as those that have them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding import decoders
from stages.hiding.convolution import Convolution
from stages.hiding.decoders import Decoder, Precision, decode
from tests.opencl.differentiated import with_gradients


def decoded(monkeypatch: pytest.MonkeyPatch, precision: Precision, *, instructions: bool) -> dict[str, Tensor]:
    """The picture and the gradients of the feature map and all weights, for a decoder drawn with a fixed seed."""
    monkeypatch.setattr(decoders, "has_bfloat16_convolutions", lambda: instructions)
    torch.manual_seed(0)
    decoder, features = Decoder(16, 3, width=32), torch.rand(18, 22, 16, requires_grad=True)
    picture = decode(decoder, features, precision)
    (picture * torch.randn(picture.shape)).sum().backward()
    gradients = {name: weight.grad for name, weight in [("features", features), *decoder.named_parameters()]}
    return {"picture": picture.detach(), **{name: value for name, value in gradients.items() if value is not None}}


def test_without_the_instructions_bfloat16_is_rounded_to_and_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    native = decoded(monkeypatch, "bfloat16", instructions=True)
    rounded = decoded(monkeypatch, "bfloat16", instructions=False)
    exact = decoded(monkeypatch, "float32", instructions=False)
    assert len(native) == len(rounded) == 2 + 2 * 5
    for name, value in native.items():
        from_native = float((rounded[name] - value).norm() / value.norm())
        from_exact = float((rounded[name] - exact[name]).norm() / exact[name].norm())
        assert from_native <= from_exact / 4, (name, from_native, from_exact)


def test_without_the_instructions_float32_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    with_them = decoded(monkeypatch, "float32", instructions=True)
    without = decoded(monkeypatch, "float32", instructions=False)
    assert all(torch.equal(value, without[name]) for name, value in with_them.items())


def test_a_decoder_has_five_convolutions_of_which_the_last_is_linear() -> None:
    """With a ReLU there, whatever starts below zero would be black and have no gradient."""
    torch.manual_seed(0)
    decoder = Decoder(16, 3)
    assert [type(module) is Convolution for module in decoder] == [True, False] * 4 + [True]
    assert float(decode(decoder, torch.randn(12, 10, 16)).detach().min()) < 0


@pytest.mark.parametrize("kernel_size", [1, 3])
def test_feature_maps_of_another_type_torch_refuses_whatever_the_kernel(kernel_size: int) -> None:
    decoder = Decoder(16, 6, width=32, kernel_size=kernel_size)
    with pytest.raises(RuntimeError, match="type"):
        decode(decoder, torch.rand(18, 22, 16, dtype=torch.float64))


@pytest.mark.parametrize("channels", [16, 24])
def test_of_single_pixels_they_are_the_same_convolutions(monkeypatch: pytest.MonkeyPatch, channels: int) -> None:
    torch.manual_seed(0)
    decoder = Decoder(channels, 6, width=32, kernel_size=1)
    features = torch.rand(18, 22, channels, requires_grad=True)

    def found() -> list[Tensor]:
        return with_gradients(decode(decoder, features), [features, *decoder.parameters()])

    by_pixels = found()
    monkeypatch.setattr(decoders, "works_in_place", lambda _: False)
    for one, other in zip(by_pixels, found(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)


def test_inputs_beyond_the_features_are_read_as_before() -> None:
    torch.manual_seed(0)
    decoder = Decoder(5, 3, width=8, kernel_size=1)
    features, beyond = torch.rand(6, 7, 4), torch.rand(6, 7, 1)
    turn = torch.linalg.qr(torch.randn(4, 4, dtype=torch.float64)).Q
    turned = (0.5 + (features.double() - 0.5) @ turn.T).float()
    with torch.no_grad():
        before = decode(decoder, torch.cat([features, beyond], dim=-1))
        decoder.read_along(turn.T)
        after = decode(decoder, torch.cat([turned, beyond], dim=-1))
    torch.testing.assert_close(after, before, rtol=0, atol=1e-5)


def test_a_decoder_of_fewer_inputs_than_features_cannot_follow_them() -> None:
    with pytest.raises(UserError, match="found 3 inputs; expected at least 4"):
        Decoder(3, 3, width=8).read_along(torch.eye(4, dtype=torch.float64))
