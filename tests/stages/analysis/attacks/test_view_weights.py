"""View weights are blending weights, influences what the cover would lose; pruning starts where it loses least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from stages.analysis.attacks.registry import attacks
from stages.analysis.attacks.target import Attacker, Knowledge, Target
from stages.analysis.attacks.view_weights import (
    ViewWeights,
    Weights,
    blending_weights,
    clusters,
    influences,
    pruning_order,
    view_weight_clustering,
    view_weight_pruning,
)
from stages.hiding.rendering import COVER
from stages.training.loop import TrainingViews
from tests.stages.analysis.attacks.containers import knowledge, target_and_owner

Prepare = Callable[[Target, int, Knowledge], Attacker]


def one_view() -> Knowledge:
    known = knowledge()
    return Knowledge(TrainingViews(known.views.cameras[:1], {}), known.extent)


def test_weights_of_all_gaussians_are_the_opacity_of_the_picture() -> None:
    target, _ = target_and_owner("gs_hider")
    known = one_view()
    rendering = target.method.render(target.gaussians, known.views.cameras[0])
    weights = blending_weights(target, known)
    assert (weights >= 0).all()
    assert torch.isclose(weights.sum(), rendering.alphas.sum(), rtol=1e-4)


def test_influence_is_the_covers_change_to_first_order() -> None:
    """Its square, averaged over many random signs, is the summed squared change of the picture as a Gaussian fades."""
    target, _ = target_and_owner("sh", count=12, opacity=-2.0)
    known = one_view()
    camera = known.views.cameras[0]
    squares = torch.stack([influences(target, seed, known).square() for seed in range(100)]).mean(dim=0)
    step = 0.5  # blending is linear in one opacity; small steps would mostly show where the footprint ends
    for row in range(3):
        pictures = []
        for sign in (-1, 1):
            logits = target.gaussians["logit_opacities"].clone()
            opacity = logits[row].sigmoid()
            logits[row] = (opacity * (1 + sign * step)).logit()
            changed = target.with_parameters({"logit_opacities": logits})
            pictures.append(target.method.render(changed.gaussians, camera).pictures[COVER])
        expected = ((pictures[1] - pictures[0]) / (2 * step)).square().sum()
        assert torch.isclose(squares[row], expected, rtol=0.4)


@pytest.mark.parametrize("clustered", [False, True])
def test_what_the_cover_does_not_need_goes_first(clustered: bool) -> None:
    count = 300
    generator = torch.Generator().manual_seed(0)
    weight = 1 + torch.rand(count, generator=generator)
    influence = torch.where(torch.arange(count) < 100, 0.01, 1.0) * (1 + torch.rand(count, generator=generator))
    weight[250:] = 0.0
    influence[250:] = 0.0
    weights = Weights(weight, influence)
    order = pruning_order(weights, clusters(weights, 0) if clustered else torch.arange(count)).tolist()
    assert sorted(order) == list(range(count))
    assert set(order[:50]) == set(range(250, 300))
    assert set(order[50:150]) == set(range(100))


def test_what_costs_least_for_the_weight_that_it_takes_goes_first() -> None:
    """Squared errors add up: 1, 0.5625 and 1.6 of them for a unit of weight."""
    weights = Weights(torch.tensor([1.0, 4.0, 10.0]), torch.tensor([1.0, 1.5, 4.0]))
    assert pruning_order(weights, torch.arange(3)).tolist() == [1, 0, 2]
    assert pruning_order(weights, torch.tensor([0, 1, 1])).tolist() == [0, 1, 2], "two together cost 18.25 for 14"


@pytest.mark.parametrize("attack", [view_weight_pruning, view_weight_clustering])
def test_a_share_is_pruned_and_the_same_each_time(attack: Callable[[ViewWeights], Prepare]) -> None:
    target, _ = target_and_owner("homogeneous")
    kept = [attack(ViewWeights())(target, 1, knowledge())(0.25).gaussians.means for _ in range(2)]
    assert len(kept[0]) == 150
    assert torch.equal(kept[0], kept[1])


def test_attacks_learn_the_weights_once_and_the_influences_once_for_each_seed() -> None:
    """`after_each` is called once for each pass over a view."""
    passes = 0

    def count() -> None:
        nonlocal passes
        passes += 1

    target, _ = target_and_owner("gs_hider", 50)
    known = replace(one_view(), after_each=count)
    every = attacks((1,))
    for attack in (every["view_weight_pruning"], every["view_weight_clustering"]):
        for seed in (0, 1, 2):
            attack.prepare(target, seed, known)
    assert passes == 1 + 3
    other, _ = target_and_owner("gs_hider", 40)
    assert len(every["view_weight_pruning"].prepare(other, 0, known)(0.5).gaussians) == 20


@pytest.mark.parametrize("attack", [view_weight_pruning, view_weight_clustering])
@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(attack: Callable[[ViewWeights], Prepare], count: int) -> None:
    target, _ = target_and_owner("gs_hider", count)
    assert len(attack(ViewWeights())(target, 0, one_view())(0.5).gaussians) == count
