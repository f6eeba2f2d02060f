"""TF32 convolutions are torch's own, with its setting on, forward and backward, and only for their duration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch
from torch import Tensor

from stages.hiding import convolution, tensor_float
from stages.hiding.convolution import Convolution
from stages.hiding.decoders import Decoder, Precision, decode
from stages.hiding.tensor_float import convolve_rounded


@pytest.mark.parametrize("side", [1, 3, 5])
def test_it_is_a_convolution_with_its_gradients(side: int) -> None:
    torch.manual_seed(0)
    inputs = [torch.randn(*shape, dtype=torch.float64).requires_grad_() for shape in ((2, 3, 6, 7), (4, 3, side, side))]
    inputs.append(torch.randn(4, dtype=torch.float64).requires_grad_())
    expected = torch.nn.functional.conv2d(*inputs, padding=side // 2)
    torch.testing.assert_close(convolve_rounded(*inputs), expected, rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(convolve_rounded, inputs)


def test_no_gradient_that_nobody_wants() -> None:
    values, weight = torch.rand(1, 3, 4, 5), torch.rand(2, 3, 3, 3, requires_grad=True)
    (gradient,) = torch.autograd.grad(convolve_rounded(values, weight, torch.rand(2)).sum(), weight)
    assert gradient.shape == weight.shape


def test_the_setting_is_on_while_it_convolves_and_then_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    rounding = tensor_float._rounding

    @contextmanager
    def watched() -> Iterator[None]:
        with rounding():
            seen.append((torch.backends.cudnn.allow_tf32, torch.backends.cudnn.deterministic))
            yield

    monkeypatch.setattr(tensor_float, "_rounding", watched)
    with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False):
        convolve_rounded(
            torch.rand(1, 3, 4, 5), torch.rand(2, 3, 3, 3, requires_grad=True), torch.rand(2)
        ).sum().backward()
        assert seen == 2 * [(True, True)]
        assert not torch.backends.cudnn.allow_tf32


def test_on_a_gpu_what_is_to_be_rounded_takes_it_and_on_the_cpu_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    monkeypatch.setattr(convolution, "convolve_rounded", lambda *each: taken.append(each) or convolve_rounded(*each))
    module, values = Convolution(16, 3, 3), torch.rand(1, 16, 6, 8)
    module(values, rounded=True)
    module, values = module.to("meta"), values.to("meta")
    module(values)
    assert not taken
    assert module(values, rounded=True).shape == (1, 3, 6, 8)
    assert len(taken) == 1


@pytest.mark.parametrize("precision", ["float32", "tf32", "bfloat16"])
def test_a_decoder_asks_it_of_every_layer(monkeypatch: pytest.MonkeyPatch, precision: Precision) -> None:
    asked = []
    forward = Convolution.forward

    def noted(module: Convolution, values: Tensor, rectified: bool = False, rounded: bool = False) -> Tensor:
        asked.append(rounded)
        return forward(module, values, rectified, rounded)

    monkeypatch.setattr(Convolution, "forward", noted)
    decode(Decoder(16, 3), torch.rand(6, 8, 16), precision)
    assert asked == 5 * [precision == "tf32"]
