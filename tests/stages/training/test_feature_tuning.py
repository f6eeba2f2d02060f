"""Tuning starts from the values as they are; the schedules of a new training take nothing back."""

from __future__ import annotations

import pytest
import torch

from pipeline.errors import UserError
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.training.feature_tuning import FeatureRates, feature_training, refuse_unknown_attributes
from stages.training.loop import TrainingViews
from stages.training.objectives import cover_term
from tests.stages.training.trainings import prepared


@pytest.mark.parametrize("method_name", ["plain", "sh"])
def test_harmonics_are_all_shown_from_the_first_iteration(method_name: str) -> None:
    """Gaussians whose colours depend on the viewing direction are tuned on their own renders."""
    trained = prepared(method_name, 1)
    rest = torch.randn(trained.gaussians["sh_rest"].shape, generator=torch.Generator().manual_seed(0))
    gaussians = trained.gaussians.with_parameters({"sh_rest": rest})
    cameras = trained.views.cameras
    with torch.no_grad():
        shown = [trained.method.render(gaussians, camera).pictures[COVER].clamp(0, 1) for camera in cameras]
    views = TrainingViews(cameras, {COVER: torch.stack(shown).mul(255).round().to(torch.uint8)})
    rates = FeatureRates(features=1e-6, final_share=1.0)
    tuning = feature_training(gaussians, trained.method, views, [cover_term(0.0)], 400, rates, seed=0)
    assert tuning.step(1)["cover"] < 1e-5, "squared error of rounding, and not of missing harmonics"


def test_attributes_of_messages_without_their_secret_are_refused() -> None:
    """3DGS+SH keeps the message in attributes that its method knows only with the secret."""
    trained = prepared("sh", 1)
    refuse_unknown_attributes(trained.gaussians, trained.method, "finetune_rtws")
    without = build_method("sh", {"sh_degree": 1})
    with pytest.raises(UserError, match=r"message_sh_base, message_sh_rest; expected the secret.*Give finetune_rtws"):
        refuse_unknown_attributes(trained.gaussians, without, "finetune_rtws")
