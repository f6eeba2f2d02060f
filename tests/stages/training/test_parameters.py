"""The settings that a workflow states reach the training loop."""

from __future__ import annotations

from pathlib import Path

import pytest

from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding import harmonics
from stages.hiding.rendering import COVER
from stages.training.loop import Training
from stages.training.parameters import TrainingParameters
from tests.running import run_stage
from tests.stages.small import message_views, scene


def test_every_setting_arrives() -> None:
    stated = {
        "iterations": 123,
        "seed": 5,
        "schedule_share": 0.5,
        "averaging": 0.9,
        "opacity_weight": 1.0,
        "scale_weight": 2.0,
        "position_rate": 3.0,
        "final_position_rate": 0.3,
    }
    of_density = {"densify_gradient": 0.1, "maximum_gaussians": 77}
    settings = TrainingParameters.model_validate(stated | of_density).settings(7.0)
    assert {name: getattr(settings, name) for name in stated} == stated
    assert settings.extent == 7.0
    assert (settings.density.gradient_threshold, settings.density.maximum_gaussians) == (0.1, 77)


def test_the_constants_are_those_of_3dgs() -> None:
    """Section 5 of Kerbl et al. (2023) and their code; `test_optimizer` tests Adam's epsilon."""
    settings = TrainingParameters().settings(1.0)
    density = settings.density
    assert (settings.position_rate, settings.final_position_rate) == (1.6e-4, 1.6e-6)
    assert (settings.opacity_rate, settings.scale_rate, settings.rotation_rate) == (5e-2, 5e-3, 1e-3)
    assert (density.gradient_threshold, density.smallest_opacity) == (2e-4, 0.005)
    assert (density.dense_fraction, density.largest_fraction) == (0.01, 0.1)
    assert harmonics.RATES == (2.5e-3, 2.5e-3 / 20)
    assert [harmonics.degree_at(3, step / 30) for step in (0, 0.9, 1, 2, 3, 30)] == [0, 0, 1, 2, 3, 3]


def test_every_setting_of_hiding_arrives(tmp_path: Path) -> None:
    """SSIM weights reach their own pictures; so do rates of features and networks, and the final share of rates."""
    stated = {"ssim_weight_cover": 0.3, "ssim_weight_message": 0.1, "lambda_message": 0.7}
    rates = {"feature_rate": 0.02, "network_rate": 0.003, "final_rate_share": 0.5}
    caught: list[Training] = []
    watched = HideScenesParameters.model_validate(
        {"iterations": 1, "feature_dim": 8, "decoder_width": 8, **stated, **rates}
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stages.hide_scenes.train", lambda context, training: caught.append(training) or [])
        inputs = {"cover": scene(tmp_path / "cover"), "messages": (message_views(tmp_path / "views"),)}
        run_stage(hide_scenes, watched, inputs, tmp_path / "made")
    [training] = caught
    cover, message = training.terms
    assert (cover.picture, cover.weight, cover.ssim_weight) == (COVER, 1.0, 0.3)
    assert (message.picture, message.weight, message.ssim_weight) == ("statue", 0.7, 0.1)
    settings = training.settings
    assert (settings.attribute_rates, settings.network_rate) == ({"raw_features": 0.02}, 0.003)
    assert settings.final_rate_share == 0.5
