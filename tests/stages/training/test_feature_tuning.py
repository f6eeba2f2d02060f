"""What is tuned goes on from what it is: nothing of it is taken back for the schedules of a new training."""

from __future__ import annotations

import pytest
import torch

from stages.hiding.rendering import COVER
from stages.scene.gaussians import Gaussians
from stages.training.feature_tuning import FeatureRates, feature_training
from stages.training.loop import TrainingViews
from stages.training.objectives import cover_term
from tests.stages.training.trainings import prepared


@pytest.mark.parametrize("method_name", ["plain", "sh"])
def test_harmonics_are_all_shown_from_the_first_iteration(method_name: str) -> None:
    """Gaussians whose colours depend on where they are seen from, and their own renders as what to learn."""
    trained = prepared(method_name, 1)
    rest = torch.randn(trained.gaussians["sh_rest"].shape, generator=torch.Generator().manual_seed(0))
    gaussians = Gaussians(trained.gaussians.parameters | {"sh_rest": rest})
    cameras = trained.views.cameras
    with torch.no_grad():
        shown = [trained.method.render(gaussians, camera).pictures[COVER].clamp(0, 1) for camera in cameras]
    views = TrainingViews(cameras, {COVER: torch.stack(shown).mul(255).round().to(torch.uint8)})
    rates = FeatureRates(features=1e-6, final_share=1.0)
    tuning = feature_training(gaussians, trained.method, views, [cover_term(0.0)], 400, rates, seed=0)
    assert tuning.step(1)["cover"] < 1e-5, "squared error of rounding, and not of missing harmonics"
