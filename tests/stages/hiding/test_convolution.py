"""`Convolution` agrees with torch's, whichever implementation it uses."""

from __future__ import annotations

import pytest
import torch

from stages.hiding import convolution
from stages.hiding.convolution import Convolution
from tests.opencl.differentiated import with_gradients


def convolved(module: Convolution, values: torch.Tensor, *, rectified: bool) -> list[torch.Tensor]:
    """The picture and all gradients, from values with channels last, as decoders have them."""
    leaf = values.clone().requires_grad_()
    picture = module(leaf.permute(2, 0, 1).unsqueeze(0), rectified=rectified)
    return with_gradients(picture, [leaf, *module.parameters()])


@pytest.mark.parametrize("rectified", [False, True])
@pytest.mark.parametrize(("channels", "outputs", "kernel_size"), [(16, 32, 3), (16, 32, 1), (5, 7, 3), (16, 16, 5)])
def test_it_is_torchs_convolution(
    monkeypatch: pytest.MonkeyPatch, channels: int, outputs: int, kernel_size: int, rectified: bool
) -> None:
    torch.manual_seed(0)
    module = Convolution(channels, outputs, kernel_size).double()
    values = torch.rand(18, 22, channels, dtype=torch.float64)
    found = convolved(module, values, rectified=rectified)
    monkeypatch.setattr(convolution, "can_convolve", lambda *_: False)
    for one, other in zip(found, convolved(module, values, rectified=rectified), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-11)
    assert found[0].shape == (1, outputs, 18, 22)


def test_decoders_of_the_usual_width_take_the_faster_way(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    convolve = convolution.convolve
    monkeypatch.setattr(convolution, "convolve", lambda *each: taken.append(each) or convolve(*each))
    Convolution(64, 64, 3)(torch.rand(1, 64, 6, 8))
    assert len(taken) == 1


def test_pictures_without_a_batch() -> None:
    torch.manual_seed(0)
    module, values = Convolution(16, 32, 3), torch.rand(16, 6, 8)
    torch.testing.assert_close(module(values), module(values.unsqueeze(0)).squeeze(0), rtol=1e-5, atol=1e-5)


def test_pictures_of_a_size_alone() -> None:
    assert Convolution(16, 32, 3).to("meta")(torch.rand(1, 16, 6, 8, device="meta")).shape == (1, 32, 6, 8)


def test_what_autocast_rounds_it_sees() -> None:
    module, values = Convolution(16, 16, 3), torch.rand(1, 16, 6, 8)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert module(values).dtype == torch.bfloat16
    assert module(values).dtype == torch.float32
