"""Attacks on features for which the scene decoder is made to compensate: the cover stays, the message is lost."""

from __future__ import annotations

import pytest
import torch

from stages.analysis.attacks.features import (
    channel_counts,
    channel_dropping,
    channel_permutation,
    compensated_rotation,
    feature_mixing,
    feature_rotation,
    permuted_counts,
)
from stages.analysis.attacks.target import Target
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.hiding.rendering import COVER
from tests.stages.analysis.attacks.containers import MESSAGE, shown, target_and_owner

COUPLED = ("gs_hider", "homogeneous")


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def changes(target: Target, owner: Method, attacked: Target) -> tuple[float, float]:
    """How much an attack changes the cover, decoded by the attacker, and the message, decoded by the owner."""
    cover = shown(attacked, attacked.method)[COVER] - shown(target, target.method)[COVER]
    message = shown(attacked, owner)[MESSAGE] - shown(target, owner)[MESSAGE]
    return float(cover.abs().max()), float(message.abs().max())


@pytest.mark.parametrize("degrees", [10.0, 90.0])
def test_homogeneous_features_are_turned_behind_the_covers_back(degrees: float) -> None:
    target, owner = target_and_owner("homogeneous")
    cover, message = changes(target, owner, compensated_rotation(target, degrees, generator()))
    assert cover < 1e-4
    assert message > 0.05


def test_gs_hider_is_turned_exactly_where_it_is_opaque() -> None:
    """Away from picture borders, features at opacity 1 are read as before; blended ones are not."""
    target, _ = target_and_owner("gs_hider")
    attacked = compensated_rotation(target, 60.0, generator())
    first, turned = target.method.networks["scene_decoder"][0], attacked.method.networks["scene_decoder"][0]
    features, others = (each.gaussians[FEATURES].sigmoid() for each in (target, attacked))

    def read(layer: torch.nn.Conv2d, pixels: torch.Tensor) -> torch.Tensor:
        return layer(pixels.T[None, :, None, :].expand(1, -1, 3, -1))[0, :, 1, 1:-1]

    assert torch.allclose(read(first, features), read(turned, others), atol=1e-4)
    cover, message = changes(*target_and_owner("gs_hider"), attacked)
    assert cover > 1e-3
    assert message > 0.05


@pytest.mark.parametrize("method", COUPLED)
def test_without_turning_the_scene_decoder_the_cover_is_lost(method: str) -> None:
    target, owner = target_and_owner(method)
    attacked = feature_rotation(target, 60.0, generator())
    assert attacked.method is target.method
    cover, message = changes(target, owner, attacked)
    assert min(cover, message) > 0.05


@pytest.mark.parametrize("degrees", [30.0, 90.0])
def test_every_feature_turns_by_the_angle(degrees: float) -> None:
    target, _ = target_and_owner("homogeneous")
    attacked = compensated_rotation(target, degrees, generator())
    before, after = (each.gaussians[FEATURES].sigmoid() - 0.5 for each in (target, attacked))
    cosines = torch.cosine_similarity(before, after, dim=1)
    assert torch.rad2deg(cosines.acos()) == pytest.approx(degrees, abs=0.1)


@pytest.mark.parametrize("method", COUPLED)
@pytest.mark.parametrize("channels", [2.0, 7.0, 16.0])
def test_every_scene_decoder_forgives_permuted_channels(method: str, channels: float) -> None:
    target, owner = target_and_owner(method)
    attacked = channel_permutation(target, channels, generator())
    moved = (attacked.gaussians[FEATURES] != target.gaussians[FEATURES]).any(dim=0)
    assert int(moved.sum()) == channels
    cover, message = changes(target, owner, attacked)
    assert cover < 1e-4
    assert message > 0.01


@pytest.mark.parametrize("method", COUPLED)
def test_every_scene_decoder_forgives_mixed_channels_where_opacities_blend_too(method: str) -> None:
    target, owner = target_and_owner(method, opacity=-1.0)
    cover, message = changes(target, owner, feature_mixing(target, 0.4, generator()))
    assert cover < 1e-3
    assert message > 0.05


def test_dropped_channels() -> None:
    target, _ = target_and_owner("gs_hider")
    assert list(channel_counts(target)) == [1, 2, 4, 8, 12]
    attacked = channel_dropping(target, 4, generator()).gaussians[FEATURES]
    constant = (attacked == attacked[:1]).all(dim=0)
    assert int(constant.sum()) == 4
    before = target.gaussians[FEATURES]
    assert torch.equal(attacked[:, ~constant], before[:, ~constant])
    means = before[:, constant].sigmoid().mean(dim=0)
    torch.testing.assert_close(attacked[0, constant].sigmoid(), means)


def test_of_few_channels_at_least_one_is_dropped_and_two_change_places() -> None:
    target, _ = target_and_owner("gs_hider")
    assert list(permuted_counts(target)) == [2, 4, 8, 12, 16]
    few = target.with_parameters({FEATURES: target.gaussians[FEATURES][:, :4]})
    assert (list(channel_counts(few)), list(permuted_counts(few))) == ([1, 2, 3], [2, 3, 4])


def test_the_published_decoder_is_left_alone() -> None:
    target, _ = target_and_owner("homogeneous")
    before = {name: values.clone() for name, values in target.method.networks["scene_decoder"].state_dict().items()}
    compensated_rotation(target, 30.0, generator())
    after = target.method.networks["scene_decoder"].state_dict()
    assert all(torch.equal(values, after[name]) for name, values in before.items())
