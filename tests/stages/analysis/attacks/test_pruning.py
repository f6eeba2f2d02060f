"""Whole Gaussians are removed or doubled: which ones, how many, and that nothing else changes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from stages.analysis.attacks.pruning import cloning, cropping, random_pruning, sequential_pruning
from stages.analysis.attacks.target import Target
from tests.stages.analysis.attacks.containers import target_and_owner

TARGET, _ = target_and_owner("gs_hider")
Attack = Callable[[Target, float, torch.Generator], Target]


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def rows(attacked: Target) -> list[int]:
    """The rows that these Gaussians had in the original."""
    means = TARGET.gaussians.means.tolist()
    return [means.index(each) for each in attacked.gaussians.means.tolist()]


@given(share=st.floats(0, 1), seed=st.integers(0, 5))
def test_counts_and_rows(share: float, seed: int) -> None:
    count = len(TARGET.gaussians)
    for attack in (random_pruning, cropping):
        kept = rows(attack(TARGET, share, generator(seed)))
        assert len(kept) == count - round(share * count)
        assert kept == sorted(set(kept))
    assert len(cloning(TARGET, share, generator(seed)).gaussians) == count + round(share * count)


def test_the_least_opaque_go_first() -> None:
    kept = sequential_pruning(TARGET, 0.25).gaussians["logit_opacities"]
    assert kept.min() >= TARGET.gaussians["logit_opacities"].quantile(0.25)
    assert len(kept) == 150


@pytest.mark.parametrize("attack", [random_pruning, cropping])
def test_what_a_weak_attack_takes_a_strong_one_takes_too(attack: Attack) -> None:
    weak, strong = (set(rows(attack(TARGET, share, generator(1)))) for share in (0.2, 0.6))
    assert strong < weak


def test_seeds_differ_and_repeat() -> None:
    assert rows(random_pruning(TARGET, 0.5, generator(1))) == rows(random_pruning(TARGET, 0.5, generator(1)))
    assert rows(random_pruning(TARGET, 0.5, generator(1))) != rows(random_pruning(TARGET, 0.5, generator(2)))


def test_what_is_cropped_out_is_a_ball() -> None:
    kept = rows(cropping(TARGET, 0.3, generator(2)))
    means = TARGET.gaussians.means
    gone = [row for row in range(len(means)) if row not in kept]
    centre = next(
        row
        for row in gone
        if (means[gone] - means[row]).norm(dim=1).max() <= (means[kept] - means[row]).norm(dim=1).min()
    )
    assert centre in gone


def test_cloned_gaussians_are_there_twice() -> None:
    found = rows(cloning(TARGET, 0.1, generator()))
    assert sorted(set(found)) == list(range(len(TARGET.gaussians)))
    assert len(found) - len(set(found)) == 20
