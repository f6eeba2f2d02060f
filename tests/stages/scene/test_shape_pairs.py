"""Pairs by sizes and opacities, and which of them agree: with 85 % wrong, the right ones are found."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.scene.moved_splats import moved
from stages.scene.shape_pairs import SAMPLED, agreeing, pairs_by_shape
from stages.scene.similarity import Similarity, fit_similarity
from tests.stages.scene.test_registration import motion, scene


@pytest.mark.parametrize("any_scale", [False, True])
def test_pairs_are_the_same_gaussians_in_any_order(any_scale: bool) -> None:
    published = scene(0)
    order = torch.randperm(len(published), generator=torch.Generator().manual_seed(0))
    found = published.select(order)
    rows, partners, alike = pairs_by_shape(moved(found, motion(1, 7.0 if any_scale else 1.0)), published, 0, any_scale)
    assert len(rows) > 0.99 * len(published)
    assert alike.all()
    np.testing.assert_array_equal(order.numpy()[rows], partners)


def test_sizes_as_they_are_stored_tell_more_than_proportions() -> None:
    published = scene(0)
    noise = 0.1 * torch.randn(len(published), 3, generator=torch.Generator().manual_seed(0))
    found = published.with_parameters({"log_scales": published["log_scales"] + noise})
    pairs = [pairs_by_shape(found, published, 0, any_scale) for any_scale in (False, True)]
    right = [np.count_nonzero(rows == partners) for rows, partners, _ in pairs]
    assert right[0] > 1.2 * right[1]
    assert all(np.mean(alike) < 0.1 for _, _, alike in pairs), "noise ten times as large as what is alike"


def test_of_many_gaussians_some_are_looked_at() -> None:
    many = scene(0, SAMPLED + 500)
    rows, _, _ = pairs_by_shape(many, many, 1)
    assert len(rows) == len(set(rows)) == SAMPLED
    again, _, _ = pairs_by_shape(many, many, 1)
    others, _, _ = pairs_by_shape(many, many, 2)
    assert np.array_equal(rows, again)
    assert set(rows) != set(others)


@pytest.mark.parametrize("wrong", [0.0, 0.5, 0.85])
def test_right_pairs_are_told_from_wrong_ones(wrong: float) -> None:
    generator = np.random.default_rng(0)
    source = generator.normal(size=(2000, 3))
    expected = motion(2, 1.5)
    target = expected.points(source)
    count = round(wrong * len(source))
    target[:count] = target[generator.permutation(count)]
    pairs = agreeing(source, target, 0)
    assert pairs is not None
    assert pairs[count:].all()
    assert pairs[:count].sum() <= 0.01 * len(source)
    fitted = fit_similarity(source[pairs], target[pairs])
    np.testing.assert_allclose(fitted.rotation, expected.rotation, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_pairs_that_are_a_little_off_are_left_out_where_others_are_exact(seed: int) -> None:
    generator = np.random.default_rng(0)
    source = generator.normal(size=(2000, 3))
    expected = motion(3)
    target = expected.points(source)
    target[:800] += [0.03, 0.0, 0.0]
    pairs = agreeing(source, target, seed)
    assert pairs is not None
    np.testing.assert_array_equal(pairs, np.arange(2000) >= 800)


def test_clusters_that_happen_to_fall_together_are_not_believed() -> None:
    generator = np.random.default_rng(0)
    source, target = (
        generator.normal(size=(15, 3))[generator.integers(15, size=1000)] + 1e-3 * generator.normal(size=(1000, 3))
        for _ in range(2)
    )
    assert agreeing(source, target, 0) is None


def test_pairs_that_agree_on_nothing_are_not_believed() -> None:
    generator = np.random.default_rng(0)
    source, target = generator.normal(size=(2, 2000, 3))
    assert agreeing(source, target, 0) is None
    assert agreeing(source, np.zeros_like(source), 0) is None
    assert agreeing(np.zeros_like(source), target, 0) is None
    heap = np.concatenate([np.zeros((500, 3)), source[:500]])
    assert agreeing(heap, np.concatenate([np.zeros((500, 3)), target[:500]]), 0) is None
    assert agreeing(source[:9], source[:9], 0) is None
    assert agreeing(source[:10], Similarity.identity().points(source[:10]), 0) is not None
