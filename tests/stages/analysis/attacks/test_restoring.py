"""The owner undoes what was done to a container as a whole, by the same means for every attack."""

from __future__ import annotations

import pytest
import torch

from stages.analysis.attacks.features import channel_permutation, compensated_rotation, feature_mixing
from stages.analysis.attacks.pruning import random_pruning
from stages.analysis.attacks.restoring import restored_target
from stages.analysis.attacks.rigid_motion import rigid_motion
from stages.analysis.attacks.target import Target
from stages.hiding.rendering import COVER
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, shown, target_and_owner

SAME = 2e-3
COUPLED = ("gs_hider", "homogeneous")


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degrees", [15.0, 90.0])
def test_a_moved_world_is_found_where_it_was_published(method: str, degrees: float) -> None:
    target, owner = target_and_owner(method)
    restored = restored_target(rigid_motion(target, degrees, generator()), target, 0)
    assert restored.motion.scale == 1
    assert not restored.motion.translation.any()
    assert restored.method is target.method
    before, after = shown(target, owner), shown(restored, owner)
    assert torch.allclose(restored.gaussians.means, target.gaussians.means, atol=1e-5)
    assert set(after) >= {COVER, MESSAGE}
    assert all((after[name] - before[name]).abs().max() < SAME for name in before)


@pytest.mark.parametrize("method", COUPLED)
def test_everything_at_once_costs_no_more_than_the_pruning(method: str) -> None:
    target, owner = target_and_owner(method)

    def pruned(attacked: Target) -> Target:
        return random_pruning(attacked, 0.25, generator())

    mixed = channel_permutation(compensated_rotation(target, 30.0, generator()), 16, generator())
    attacked = pruned(rigid_motion(mixed, 70.0, generator()))
    alone = shown(pruned(target), owner)
    assert (shown(attacked, owner)[MESSAGE] - alone[MESSAGE]).abs().max() > 0.05
    after = shown(restored_target(attacked, target, 0), owner)
    assert all((after[name] - alone[name]).abs().max() < SAME for name in (COVER, MESSAGE))


@pytest.mark.parametrize("method", COUPLED)
def test_mixed_channels_are_told_apart_again(method: str) -> None:
    target, owner = target_and_owner(method)
    mixed = feature_mixing(target, 0.4, generator())
    before = shown(target, owner)[MESSAGE]
    assert (shown(mixed, owner)[MESSAGE] - before).abs().max() > 0.05
    assert (shown(restored_target(mixed, target, 0), owner)[MESSAGE] - before).abs().max() < SAME


def test_what_needs_no_restoring_is_the_attacked_target_itself() -> None:
    target, _ = target_and_owner("homogeneous")
    for attacked in (target, random_pruning(target, 0.5, generator())):
        assert restored_target(attacked, target, 0) is attacked


def test_what_is_not_recognised_is_left_alone() -> None:
    target, _ = target_and_owner("homogeneous")
    strange = target.with_parameters({"means": target.gaussians.means.flip(0) * 3})
    assert restored_target(strange, target, 0) is strange
