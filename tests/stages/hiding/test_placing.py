"""Messages are placed where they fill the pictures, but not so close that they cannot be made out."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.hiding import placing
from stages.hiding.method import build_method
from stages.hiding.placing import clear_coverage, clear_depth, coverage_score, place, shrunken
from stages.hiding.rendering import COVER
from stages.scene.alignment import nearest_depth
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.message_views import LEGAL_COVERAGE
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity
from tests.stages.scene.rigs import arc, moved

SIZE = (32, 24)


def camera_at(z: float) -> Cameras:
    """One camera that looks down +z."""
    pose = np.eye(4)
    pose[2, 3] = -z
    intrinsics = np.array([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
    return Cameras(("0.png",), pose[None], intrinsics, *SIZE)


def wall(depth: float) -> np.ndarray:
    across, down = np.meshgrid(np.linspace(-6, 6, 60), np.linspace(-6, 6, 60))
    return np.stack([across.ravel(), down.ravel(), np.full(across.size, depth)], axis=1)


def opaque(points: np.ndarray) -> Gaussians:
    method = build_method("plain", {"sh_degree": 0})
    attributes = method.initial_attributes({COVER: np.full((len(points), 3), 0.7)}, np.random.default_rng(0))
    gaussians = gaussians_at(points, attributes)
    gaussians.parameters["logit_opacities"] = torch.full((len(points),), 5.0)
    return gaussians


def test_a_shrunken_camera_sees_the_same() -> None:
    cameras = camera_at(0)
    small = shrunken(cameras, 16)
    assert (small.width, small.height) == (16, 12)
    ray = np.linalg.inv(cameras.intrinsics[0]) @ [32, 24, 1]
    np.testing.assert_allclose(small.intrinsics[0] @ ray, [16, 12, 1])
    same = shrunken(cameras, 64)
    assert (same.width, same.height) == SIZE, "no picture is enlarged"


def test_what_stands_too_close_hides_and_counts_nothing() -> None:
    scene = opaque(wall(5.0))
    far, near = (float(clear_coverage(scene, camera_at(z), 32, clear_from=2.0)[0]) for z in (0.0, 4.0))
    assert far > 0.95
    assert near == 0
    behind = opaque(np.concatenate([wall(5.0), wall(9.0)]))
    assert float(clear_coverage(behind, camera_at(4.0), 32, clear_from=2.0)[0]) < 0.05


def test_few_pixels_tell_how_much_small_gaussians_fill() -> None:
    specks = opaque(np.random.default_rng(0).uniform([-3, -2, 5], [3, 2, 6], (20_000, 3)))
    specks.parameters["log_scales"] = torch.full((len(specks), 3), np.log(2e-3))
    large = camera_at(0.0)
    scaling = np.diag([10.0, 10.0, 1.0])
    large = Cameras(large.names, large.world_to_camera, scaling @ large.intrinsics, 320, 240)
    whole, few = (clear_coverage(specks, large, width, clear_from=2.0) for width in (320, 40))
    assert 0.3 < whole[0] < 0.7
    np.testing.assert_allclose(few, whole, atol=0.03)


def test_legal_views_count_before_mean_coverage() -> None:
    assert coverage_score(np.array([0.95, 0.2])) > coverage_score(np.array([0.89, 0.89]))
    assert coverage_score(np.array([LEGAL_COVERAGE])) == (1, LEGAL_COVERAGE)
    assert coverage_score(np.array([1.0, 1.0])) == coverage_score(np.array([0.95, 0.91]))


def test_the_nearest_depth_is_that_of_what_pictures_show() -> None:
    camera = camera_at(0)
    points = np.concatenate([wall(5.0), wall(-1.0)])  # the second wall is behind the camera
    assert nearest_depth(camera, points) == pytest.approx(5.0)
    assert nearest_depth(camera, np.empty((0, 3))) == 0


def test_surfaces_count_from_half_the_depth_of_what_a_message_shows() -> None:
    points, pictures = wall(5.0).astype(np.float32), np.zeros((1, SIZE[1], SIZE[0], 3), np.uint8)
    message = Scene(camera_at(0), pictures, points, np.zeros(points.shape, np.uint8), ())
    assert clear_depth(message) == pytest.approx(2.5)


def scene_of(cameras: Cameras, points: np.ndarray) -> Scene:
    pictures = np.zeros((len(cameras), cameras.height, cameras.width, 3), np.uint8)
    return Scene(cameras, pictures, points.astype(np.float32), np.zeros(points.shape, np.uint8), cameras.names[:1])


def placed(message: Scene, cover: Scene, monkeypatch: pytest.MonkeyPatch) -> tuple[Similarity, Cameras, set[float]]:
    """The first candidate, which wins among equals, the cameras that it was seen from, and depths that counted."""
    seen: list[Cameras] = []
    counted = set()

    def alike(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> np.ndarray:
        seen.append(cameras)
        counted.add(clear_from)
        return np.ones(len(cameras), np.float32)

    monkeypatch.setattr(placing, "clear_coverage", alike)
    similarity = place(opaque(message.points), message, cover, 16, lambda *_: None)
    return similarity, seen[0], counted


def test_a_cover_that_was_taken_as_the_message_was_sees_it_as_its_photos_do(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (300, 3))
    own = arc(np.zeros(3), views=5, degrees=90.0)
    away = Similarity(3.0, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([5.0, 6, 7]))
    message, cover = scene_of(own, points), scene_of(moved(own, away), away.points(points))
    _, seen, counted = placed(message, cover, monkeypatch)
    np.testing.assert_allclose(seen.centres(), own.centres(), atol=0.05)
    assert counted == {clear_depth(message)}, "in the message's units"
    assert clear_depth(message) > 1


def test_a_cover_whose_cameras_look_side_by_side_looks_as_far_as_its_points_lie(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [-0.2, 0.0, 0.2]
    side_by_side = Cameras(("a", "b", "c"), poses, np.tile(camera_at(0).intrinsics, (3, 1, 1)), *SIZE)
    message = scene_of(arc(np.zeros(3), views=5), np.random.default_rng(0).uniform(-1, 1, (300, 3)))
    near, far = (placed(message, scene_of(side_by_side, wall(depth)), monkeypatch)[0] for depth in (5.0, 10.0))
    assert far.scale == pytest.approx(2 * near.scale, rel=0.01)
