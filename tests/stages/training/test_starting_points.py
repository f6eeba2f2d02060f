"""Starting points: random ones lie before the cameras, those of a message have its colours and are not too near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.hiding.rendering import COVER
from stages.scene.cameras import Cameras
from stages.scene.message_views import MessagePictures
from stages.scene.scene import Scene
from stages.training.starting_points import (
    FARTHER,
    NEARER,
    Start,
    clear_of_cameras,
    points_before_cameras,
    starting_points,
)


def scene_with(points: np.ndarray) -> Scene:
    turn = np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 2], [0, 0, 0, 1]])
    intrinsics = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])
    cameras = Cameras(("a", "b", "c"), np.stack([np.eye(4), np.eye(4), turn]), np.stack([intrinsics] * 3), 32, 24)
    colors = np.full((len(points), 3), 200, np.uint8)
    return Scene(cameras, np.zeros((3, 24, 32, 3), np.uint8), points.astype(np.float32), colors, ("a",))


def cloud() -> np.ndarray:
    return np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (200, 3))


def test_each_point_is_in_the_picture_of_a_training_camera() -> None:
    scene = scene_with(cloud())
    points = points_before_cameras(scene, 500, np.random.default_rng(1))
    seen = np.zeros(500, bool)
    for pose, intrinsics in zip(scene.cameras.world_to_camera[1:], scene.cameras.intrinsics[1:], strict=True):
        places = points @ pose[:3, :3].T + pose[:3, 3]
        pixels = places @ intrinsics.T
        inside = (pixels[:, :2] >= 0).all(1) & (pixels[:, :2] <= pixels[:, 2:] * (32, 24)).all(1)
        depths = scene.points @ pose[2, :3] + pose[2, 3]
        within = (places[:, 2] > NEARER * depths.min()) & (places[:, 2] < FARTHER * depths.max())
        seen |= inside & within
    assert seen.all()


def test_sparse_points_come_first_with_their_colors() -> None:
    scene = scene_with(cloud())
    points, colors = starting_points(scene, {}, Start(True, 0, 7, seed=0))
    assert len(points) == 207
    np.testing.assert_allclose(points[:200], scene.points)
    np.testing.assert_allclose(colors[COVER][:200], 200 / 255)
    np.testing.assert_allclose(colors[COVER][200:], 0.5)


def test_points_of_a_message_have_its_colors_and_are_grey_in_the_cover() -> None:
    scene = scene_with(cloud())
    pictures = np.zeros((3, 24, 32, 3), np.uint8)
    far = (cloud() + 9).astype(np.float32)
    message = MessagePictures("m", ("a", "b", "c"), pictures, far, np.full((200, 3), 51, np.uint8))
    points, colors = starting_points(scene, {"m": message}, Start(True, 30, 0, seed=0))
    assert len(points) == 230
    assert {tuple(point) for point in points[200:].tolist()} <= {tuple(point) for point in far.astype(float).tolist()}
    np.testing.assert_allclose(colors["m"][200:], 0.2)
    np.testing.assert_allclose(colors["m"][:200], 0.5)
    np.testing.assert_allclose(colors[COVER][200:], 0.5)


def test_each_point_of_a_message_has_its_own_color_where_others_were_too_near() -> None:
    scene = scene_with(cloud())
    pictures = np.zeros((3, 24, 32, 3), np.uint8)
    points = np.concatenate([[[0.0, 0, 0.5]], cloud()[:30] + 9]).astype(np.float32)
    shades = np.arange(31, dtype=np.uint8)[:, None].repeat(3, 1)
    message = MessagePictures("m", ("a", "b", "c"), pictures, points, shades)
    found, colors = starting_points(scene, {"m": message}, Start(True, 30, 0, seed=0))
    np.testing.assert_allclose(found[200:], points[1:])
    np.testing.assert_allclose(colors["m"][200:, 0] * 255, np.arange(1, 31))


def test_the_same_seed_gives_the_same_points() -> None:
    scene = scene_with(cloud())
    first, second, other = (starting_points(scene, {}, Start(False, 0, 20, seed))[0] for seed in (3, 3, 4))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_a_scene_without_points_is_refused() -> None:
    with pytest.raises(UserError, match="no sparse points"):
        starting_points(scene_with(np.empty((0, 3))), {}, Start(True, 0, 0, seed=0))


def test_a_start_without_any_gaussian_is_refused() -> None:
    with pytest.raises(UserError, match="no Gaussians to start from"):
        starting_points(scene_with(cloud()), {}, Start(sparse_points=False, message_points=0, random_points=0, seed=0))


def test_no_point_of_a_message_stands_right_before_a_training_camera() -> None:
    """The cover's nearest things are 3 units away."""
    scene = scene_with(cloud())
    near, far = np.array([[0.0, 0, 1], [0.5, 0, -0.5]]), np.array([[0.0, 0, 6], [0, 0, 7], [0, 9, 0]])
    assert clear_of_cameras(scene, np.concatenate([near, far])).tolist() == [2, 3, 4]
    assert clear_of_cameras(scene, np.zeros((0, 3))).tolist() == []


def test_points_of_a_message_may_be_a_quarter_nearer_than_the_covers_nearest_things() -> None:
    """Those are 3 units away, so points within 2.25 units are too near."""
    behind = np.array([[0.0, 0, -2.2], [0, 0, -2.4], [0, 0, -2.9]])
    assert clear_of_cameras(scene_with(cloud()), behind).tolist() == [1, 2]


def test_without_random_points_no_depths_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stages.training.starting_points._depth_limits", None)
    points, _ = starting_points(scene_with(cloud()), {}, Start(True, 0, random_points=0, seed=0))
    assert points.shape == (200, 3)


def test_random_points_are_uniform_in_inverse_depth() -> None:
    """Each quarter of the range of inverse depths holds a quarter of the points."""
    scene = replace(scene_with(cloud()), test_names=("a", "c"))
    inverse = 1 / points_before_cameras(scene, 4000, np.random.default_rng(0))[:, 2]
    shares = (inverse - inverse.min()) / (inverse.max() - inverse.min())
    np.testing.assert_allclose(np.quantile(shares, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.03)
