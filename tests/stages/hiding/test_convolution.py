"""Converted for its weights or not, a convolution is the same function and has the same gradients."""

from __future__ import annotations

import pytest
import torch

from stages.hiding import convolution
from stages.hiding.convolution import Convolution


def convolved(
    monkeypatch: pytest.MonkeyPatch, kernel_size: int, *, converts: bool, fixed_input: bool = False
) -> dict[str, torch.Tensor]:
    """Picture and gradients, of channels last as decoders have it."""
    monkeypatch.setattr(convolution, "converts_for_weights", lambda: converts)
    torch.manual_seed(0)
    module = Convolution(5, 7, kernel_size).double().to(memory_format=torch.channels_last)
    values = torch.rand(18, 22, 5, dtype=torch.float64, requires_grad=not fixed_input)
    picture = module(values.permute(2, 0, 1).unsqueeze(0))
    (picture * torch.randn(picture.shape, dtype=torch.float64)).sum().backward()
    found = {"picture": picture.detach(), "weight": module.weight.grad, "bias": module.bias.grad, "values": values.grad}
    return {name: tensor for name, tensor in found.items() if tensor is not None}


@pytest.mark.parametrize("kernel_size", [1, 3, 5])
@pytest.mark.parametrize("fixed_input", [False, True])
def test_it_is_torchs_convolution(monkeypatch: pytest.MonkeyPatch, kernel_size: int, fixed_input: bool) -> None:
    usual = convolved(monkeypatch, kernel_size, converts=False, fixed_input=fixed_input)
    found = convolved(monkeypatch, kernel_size, converts=True, fixed_input=fixed_input)
    assert found.keys() == usual.keys() == {"picture", "weight", "bias"} | ({"values"} if not fixed_input else set())
    for name, value in usual.items():
        torch.testing.assert_close(found[name], value, rtol=1e-12, atol=1e-12)
    assert found["picture"].shape == (1, 7, 18, 22)


def test_gradients_by_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convolution, "converts_for_weights", lambda: True)
    module = Convolution(2, 3, 3).double()

    def function(values: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        result: torch.Tensor = torch.func.functional_call(module, {"weight": weight, "bias": bias}, (values,))
        return result

    inputs = (torch.rand(1, 2, 4, 5), module.weight.detach(), module.bias.detach())
    assert torch.autograd.gradcheck(function, [each.double().clone().requires_grad_() for each in inputs])


def test_frozen_weights_have_no_gradient_and_the_input_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convolution, "converts_for_weights", lambda: True)
    module = Convolution(2, 3, 3).requires_grad_(False)
    values = torch.rand(1, 2, 4, 5, requires_grad=True)
    module(values).sum().backward()
    assert values.grad is not None
    assert module.weight.grad is None
