from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.scene.alignment import project
from stages.scene.similarity import Similarity, fit_similarity
from tests.stages.scene.rigs import arc, moved, similarities

seeds = st.integers(0, 2**32 - 1)


def random_points(seed: int, count: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


@given(similarities(), seeds)
def test_the_inverse_takes_points_back(similarity: Similarity, seed: int) -> None:
    points = random_points(seed)
    np.testing.assert_allclose(similarity.inverse().points(similarity.points(points)), points, atol=1e-9)


@given(similarities(), similarities(), seeds)
def test_composition_is_one_after_the_other(second: Similarity, first: Similarity, seed: int) -> None:
    points = random_points(seed)
    expected = second.points(first.points(points))
    np.testing.assert_allclose(second.compose(first).points(points), expected, atol=1e-8)


@given(similarities(), seeds)
def test_moved_cameras_show_the_moved_world_as_before(similarity: Similarity, seed: int) -> None:
    cameras, points = arc(np.zeros(3)), random_points(seed)
    before, depth = project(cameras, points)
    after, moved_depth = project(moved(cameras, similarity), similarity.points(points))
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moved_depth, similarity.scale * depth, rtol=1e-7, atol=1e-7)


@given(similarities(), seeds)
def test_gaussians_move_with_their_covariance(similarity: Similarity, seed: int) -> None:
    random = np.random.default_rng(seed)
    means, quats, log_scales = random_points(seed), random.normal(size=(12, 4)), random.normal(size=(12, 3))
    moved_means, moved_quats, moved_scales = similarity.gaussians(means, quats, log_scales)
    turn = similarity.scale * similarity.rotation
    expected = turn @ covariances(quats, log_scales) @ turn.T
    np.testing.assert_allclose(moved_means, similarity.points(means))
    np.testing.assert_allclose(covariances(moved_quats, moved_scales), expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(moved_quats, axis=1), np.linalg.norm(quats, axis=1))


def covariances(quats: np.ndarray, log_scales: np.ndarray) -> np.ndarray:
    axes = Rotation.from_quat(quats[:, [1, 2, 3, 0]]).as_matrix() * np.exp(log_scales)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


@given(similarities(), seeds, st.integers(3, 20))
def test_a_similarity_is_found_from_its_points(similarity: Similarity, seed: int, count: int) -> None:
    source = random_points(seed, count)
    found = fit_similarity(source, similarity.points(source))
    np.testing.assert_allclose(found.points(source), similarity.points(source), rtol=1e-6, atol=1e-6)
    assert found.scale == pytest.approx(similarity.scale, rel=1e-6)


@settings(max_examples=30)
@given(similarities(), seeds)
def test_the_fit_is_the_best_nearby(similarity: Similarity, seed: int) -> None:
    random = np.random.default_rng(seed)
    source = random_points(seed)
    target = similarity.points(source) + random.normal(size=source.shape) * similarity.scale * 0.3
    fitted = fit_similarity(source, target)
    error = ((fitted.points(source) - target) ** 2).sum()
    for _ in range(10):
        nudge = Rotation.from_rotvec(random.normal(size=3) * 0.02).as_matrix()
        other = Similarity(fitted.scale * random.uniform(0.98, 1.02), fitted.rotation @ nudge, fitted.translation)
        assert ((other.points(source) - target) ** 2).sum() >= error


def test_mirrored_points_get_a_rotation_nevertheless() -> None:
    source = random_points(0)
    found = fit_similarity(source, source * [-1, 1, 1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)


@pytest.mark.parametrize(
    "source",
    [np.zeros((2, 3)), np.zeros((5, 3)), np.full((5, 3), 7.3)],
    ids=["too few", "all at the origin", "all in one place"],
)
def test_points_that_say_nothing_are_refused(source: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"three pairs|coincide"):
        fit_similarity(source, random_points(1, len(source)))


@pytest.mark.parametrize(
    ("scale", "rotation", "translation"),
    [
        (0.0, np.eye(3), np.zeros(3)),
        (-1.0, np.eye(3), np.zeros(3)),
        (np.nan, np.eye(3), np.zeros(3)),
        (1.0, np.diag([1.0, 1.0, -1.0]), np.zeros(3)),
        (1.0, 2 * np.eye(3), np.zeros(3)),
        (1.0, np.eye(3), np.array([0, np.inf, 0])),
    ],
)
def test_what_is_no_similarity_is_refused(scale: float, rotation: np.ndarray, translation: np.ndarray) -> None:
    with pytest.raises(ValueError, match="similarity"):
        Similarity(scale, rotation, translation)


def test_no_points_stay_no_points() -> None:
    assert Similarity.identity().points(np.empty((0, 3))).shape == (0, 3)
