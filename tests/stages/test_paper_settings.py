"""Stages do by default what the paper says of GS-Hider, and where it is silent, what its released code does."""

from __future__ import annotations

from stages.hide_image import HideImageParameters
from stages.hide_scenes import HideScenesParameters


def test_values_of_the_paper() -> None:
    """M, layers, λ, γ and β; λ = 0.1 for single images."""
    scenes = HideScenesParameters()
    assert (scenes.method, scenes.feature_dim, scenes.layers, scenes.lambda_message) == ("gs_hider", 16, 5, 0.5)
    assert (scenes.ssim_weight_cover, scenes.ssim_weight_message) == (0.2, 0.2)
    assert HideImageParameters().lambda_message == 0.1


def test_values_of_the_released_code() -> None:
    scenes = HideScenesParameters()
    assert (scenes.decoder_width, scenes.kernel_size) == (64, 3)
