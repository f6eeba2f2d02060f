"""Stages do by default what the paper says of GS-Hider. Where it is silent, sizes are the released code's; the start,
the rates of features and decoders, and the number of iterations are ours (`workflows/profiles/released_code.yaml` has
the released code's)."""

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


def test_values_of_our_own() -> None:
    """With those of the released code, short trainings learn less of a message (`relations.md`)."""
    scenes = HideScenesParameters()
    released = {"initial_features": "zeros", "feature_rate": 0.0025, "final_rate_share": 1.0, "iterations": 50_000}
    ours = {"initial_features": "colors", "feature_rate": 0.05, "final_rate_share": 0.1, "iterations": 30_000}
    assert {name: getattr(scenes, name) for name in released} == ours
