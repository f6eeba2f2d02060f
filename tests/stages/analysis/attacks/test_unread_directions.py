"""Directions that the scene decoder does not read go first, and the published decoder stays as it is."""

from __future__ import annotations

import torch

from stages.analysis.attacks.target import Target
from stages.analysis.attacks.unread_directions import sensitivity, unread_directions
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.hiding.rendering import COVER
from tests.stages.analysis.attacks.containers import MESSAGE, knowledge, shown, target_and_owner


def changes(target: Target, owner: Method, attacked: Target) -> tuple[float, float]:
    """How much an attack changes the cover, decoded by the attacker, and the message, decoded by the owner."""
    cover = shown(attacked, attacked.method)[COVER] - shown(target, target.method)[COVER]
    message = shown(attacked, owner)[MESSAGE] - shown(target, owner)[MESSAGE]
    return float(cover.abs().max()), float(message.abs().max())


def test_unread_directions_cost_the_homogeneous_cover_nothing_until_they_are_read() -> None:
    target, owner = target_and_owner("homogeneous")
    cover, message = changes(target, owner, unread_directions(target, 0, knowledge())(8))
    assert cover < 1e-4
    assert message > 0.05
    cover, _ = changes(target, owner, unread_directions(target, 0, knowledge())(12))
    assert cover > 1e-3


def test_removed_directions_are_constant_but_for_values_that_cannot_be_stored() -> None:
    target, _ = target_and_owner("gs_hider")
    target = target.with_parameters({FEATURES: target.gaussians[FEATURES] + 1})
    features = unread_directions(target, 0, knowledge())(4).gaussians[FEATURES].double().sigmoid()
    values = torch.linalg.svdvals(features - features.mean(dim=0))
    assert (values[-4:] < 1e-2 * values[0]).all()
    assert (values[:-4] > 1e-1 * values[0]).all()
    before = target.gaussians[FEATURES].double().sigmoid()
    assert (features.mean(dim=0) - before.mean(dim=0)).abs().max() < 1e-2


def test_what_is_heeded_is_what_the_decoder_reads() -> None:
    target, _ = target_and_owner("homogeneous")
    decoder = dict(target.method.networks["scene_decoder"].named_parameters())
    rows = torch.cat([decoder["directions"], decoder["readings"].flatten(0, 1)]).double()
    values, directions = torch.linalg.eigh(sensitivity(target, 0, knowledge()))
    assert (values[: 16 - len(rows)] < 1e-9 * values[-1]).all()
    assert (rows @ directions[:, : 16 - len(rows)]).abs().max() < 1e-4
    first, again, other = (sensitivity(target, seed, knowledge()) for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_published_decoder_is_left_alone() -> None:
    target, _ = target_and_owner("homogeneous")
    before = {name: values.clone() for name, values in target.method.networks["scene_decoder"].state_dict().items()}
    unread_directions(target, 0, knowledge())(4)
    after = target.method.networks["scene_decoder"].state_dict()
    assert all(torch.equal(values, after[name]) for name, values in before.items())
