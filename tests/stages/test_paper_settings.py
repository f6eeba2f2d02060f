"""What the paper says of GS-Hider, and its released code where the paper is silent, is what stages do by default."""

from __future__ import annotations

import torch

from stages.hide_image import HideImageParameters
from stages.hide_scenes import HideScenesParameters
from stages.hiding.convolution import Convolution
from stages.hiding.decoders import Decoder, decode
from stages.training.objectives import Compared, PictureTerm


def test_values_of_the_paper() -> None:
    """M, layers, λ, γ and β; λ = 0.1 of single images."""
    scenes = HideScenesParameters()
    assert (scenes.method, scenes.feature_dim, scenes.layers, scenes.lambda_message) == ("gs_hider", 16, 5, 0.5)
    assert (scenes.ssim_weight_cover, scenes.ssim_weight_message) == (0.2, 0.2)
    assert HideImageParameters().lambda_message == 0.1


def test_values_of_the_released_code() -> None:
    scenes = HideScenesParameters()
    assert (scenes.decoder_width, scenes.kernel_size) == (64, 3)


def test_a_decoder_has_five_convolutions_of_which_the_last_is_linear() -> None:
    """A ReLU there would show black, without a gradient, whatever starts below zero."""
    torch.manual_seed(0)
    decoder = Decoder(16, 3)
    assert [type(module) is Convolution for module in decoder] == [True, False] * 4 + [True]
    assert float(decode(decoder, torch.randn(12, 10, 16)).detach().min()) < 0


def test_a_trainings_psnr_is_of_the_picture_as_it_is_shown() -> None:
    """Clamped to [0, 1]; the loss is not."""
    truth = torch.tensor([0.0, 1.0])[:, None, None].expand(2, 4, 3)
    shown = Compared(PictureTerm("cover", 1.0, 0.2), 2 * truth - 0.5, truth)
    assert shown.squared_error() == 0
    assert Compared(shown.term, truth.flip(0), truth).squared_error() == 1
