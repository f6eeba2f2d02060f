"""The prior prefers transparent and small Gaussians, whatever the photos show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from stages.scene.gaussians import gaussians_at
from stages.training.loop import Training
from stages.training.prior import prior
from tests.stages.training.trainings import prepared

EXTENT = 4.0


def test_it_is_the_mean_opacity_and_the_mean_scale_of_the_rig_s_extent() -> None:
    gaussians = gaussians_at(np.array([[0.0, 0, 0], [0, 0, 2]]), {})
    gaussians.parameters["logit_opacities"] = torch.tensor([0.2, 0.6]).logit()
    gaussians.parameters["log_scales"] = torch.tensor([[1.0, 2, 3], [2, 2, 2]]).log()
    weighed = prior(gaussians, opacity_weight=10.0, scale_weight=3.0, extent=EXTENT)
    assert weighed is not None
    assert float(weighed) == pytest.approx(10 * 0.4 + 3 * 2 / EXTENT)


def test_it_does_not_depend_on_the_scene_s_unit() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (20, 3))
    once, thrice = (prior(gaussians_at(scale * points, {}), 1.0, 1.0, scale * EXTENT) for scale in (1, 3))
    assert once is not None
    assert thrice is not None
    assert float(once) == pytest.approx(float(thrice), rel=1e-6)


@pytest.mark.parametrize(("count", "weight"), [(3, 0.0), (0, 1.0)])
def test_without_weights_or_gaussians_there_is_none(count: int, weight: float) -> None:
    assert prior(gaussians_at(np.zeros((count, 3)), {}), weight, weight, EXTENT) is None


@pytest.mark.parametrize(("weight", "held"), [("opacity_weight", "opacities"), ("scale_weight", "scales")])
def test_a_training_that_it_outweighs_ends_with_less(weight: str, held: str) -> None:
    """Without density control, which prunes what becomes transparent."""
    without, weighed = (ended(**{weight: value}) for value in (0.0, 1e4))
    assert getattr(weighed, held).mean() < 0.9 * getattr(without, held).mean()


def ended(**weights: float):
    training = prepared("plain", 30)
    settings = replace(training.settings, density=None, **weights)
    training = Training(training.gaussians, training.method, training.views, training.terms, settings)
    training.run(lambda: None)
    return training.gaussians


def test_it_counts_once_for_all_views() -> None:
    """The first step's loss is computed before anything has changed."""
    training = prepared("plain", 1)
    settings = replace(training.settings, opacity_weight=30.0)
    weighed = Training(training.gaussians, training.method, training.views, training.terms, settings)
    expected = 30 * float(training.gaussians.opacities.detach().mean()) / len(training.views.cameras)
    losses = [each.step(1)["loss"] for each in (weighed, prepared("plain", 1))]
    assert losses[0] - losses[1] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("weight", "resets"), [(0.0, [1_500, 3_000, 4_500, 6_000]), (0.2, [])])
def test_that_of_opacities_stands_in_for_their_resets(weight: float, resets: list[int]) -> None:
    """With both, kitchen hiding bonsai lost a fifth of its Gaussians at every reset, and in the end its message."""
    training = prepared("plain", 15_000)
    settings = replace(training.settings, opacity_weight=weight)
    training = Training(training.gaussians, training.method, training.views, training.terms, settings)
    assert [iteration for iteration in range(1, 15_001) if training.schedule.resets_opacity_at(iteration)] == resets
