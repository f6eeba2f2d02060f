"""The path of a video: near the cameras, at constant speed, with a level horizon, in any world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from stages.scene.alignment import rig_of
from stages.scene.camera_path import Course, camera_path
from stages.scene.cameras import Cameras
from stages.scene.similarity import Similarity
from stages.scene.tours import step_lengths
from tests.stages.scene.rigs import arc, moved, similarities

NO_POINTS = np.empty((0, 3))
TARGET = np.array([0.3, -0.2, 0.5])


def shaken(cameras: Cameras, seed: int = 0) -> Cameras:
    """The rig in random order, each camera moved and turned a little."""
    random = np.random.default_rng(seed)
    poses = cameras.world_to_camera[random.permutation(len(cameras))]
    turns = Rotation.from_rotvec(random.normal(scale=0.03, size=(len(cameras), 3))).as_matrix()
    poses = poses.copy()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    poses[:, :3, 3] += random.normal(scale=0.05, size=(len(cameras), 3))
    return replace(cameras, world_to_camera=poses)


def steps(path: Cameras) -> np.ndarray:
    return np.linalg.norm(np.diff(path.centres(), axis=0), axis=1)


def speeds(path: Cameras, distance: float) -> np.ndarray:
    """Distances between consecutive frames: steps, as shares of `distance`, and turns are combined into one length."""
    return step_lengths(np.concatenate([path.centres() / distance, path.world_to_camera[:, 2, :3]], axis=1))


def test_round_a_ring_and_back_to_the_beginning() -> None:
    ring = shaken(arc(TARGET, views=30))
    path = camera_path(ring, NO_POINTS, frames=60)
    seam = np.linalg.norm(path.centres()[0] - path.centres()[-1])
    assert seam == pytest.approx(steps(path).mean(), rel=0.1)
    offsets = path.centres() - TARGET
    azimuth = np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0]))
    assert abs(azimuth[-1] - azimuth[0]) == pytest.approx(2 * np.pi * 59 / 60, abs=0.05)
    np.testing.assert_allclose(np.linalg.norm(offsets[:, :2], axis=1), 4.0, rtol=0.08)
    np.testing.assert_allclose(offsets[:, 2], 1.5, atol=0.15)
    middles = path.world_to_camera[:, :3, :3] @ TARGET + path.world_to_camera[:, :3, 3]
    assert (np.linalg.norm(middles[:, :2], axis=1) / middles[:, 2] < 0.05).all()


def test_along_an_arc_and_no_further() -> None:
    path = camera_path(shaken(arc(TARGET, views=20, degrees=150)), NO_POINTS, frames=40)
    azimuth = np.degrees(np.arctan2(*(path.centres() - TARGET)[:, [1, 0]].T))
    assert np.abs(azimuth).max() < 76
    assert np.ptp(azimuth) > 130
    assert (np.diff(azimuth) > 0).all() or (np.diff(azimuth) < 0).all()


def test_the_course_can_be_chosen() -> None:
    ring = arc(TARGET, views=20)
    opened = camera_path(ring, NO_POINTS, 40, course="open")
    closed = camera_path(arc(TARGET, views=20, degrees=150), NO_POINTS, 40, course="closed")
    assert np.linalg.norm(np.subtract(*opened.centres()[[0, -1]])) > 3 * steps(opened).mean()
    assert np.linalg.norm(np.subtract(*closed.centres()[[0, -1]])) < 2 * steps(closed).mean()


@pytest.mark.parametrize("course", ["closed", "open"])
def test_never_where_nobody_looked_from(course: Course) -> None:
    """Columns of cameras along an arc, whose two ends are not joined by cameras."""
    heights = (1.0, 1.7, 2.4)
    columns = [arc(TARGET, views=20, degrees=200, height=height).world_to_camera for height in heights]
    rig = replace(arc(TARGET, views=60), world_to_camera=np.concatenate(columns))
    path = camera_path(rig, NO_POINTS, 60, course=course)
    away = np.linalg.norm(path.centres()[:, None] - rig.centres(), axis=2).min(axis=1)
    assert away.max() < 0.6, "some camera stands within a step of every frame"


@pytest.mark.parametrize("degrees", [120, 360])
def test_constant_speed_and_level_horizon(degrees: float) -> None:
    cameras = shaken(arc(TARGET, views=25, degrees=degrees))
    path = camera_path(cameras, NO_POINTS, 50)
    rig = rig_of(cameras, NO_POINTS)
    speed = speeds(path, rig.distance)
    np.testing.assert_allclose(speed, speed.mean(), rtol=0.05)
    assert np.abs(path.world_to_camera[:, 0, :3] @ rig.up).max() < 1e-3
    assert (path.world_to_camera[:, 1, :3] @ rig.up < 0).all(), "nothing stands on its head"


def test_smooth_places_and_turns() -> None:
    """From frame to frame, steps and turns change by less than a quarter of their mean."""
    path = camera_path(shaken(arc(TARGET, views=30)), NO_POINTS, 120)
    velocity = np.diff(path.centres(), axis=0)
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 0.25 * steps(path).mean()
    rotations = Rotation.from_matrix(path.world_to_camera[:, :3, :3])
    turns = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
    assert np.linalg.norm(np.diff(turns, axis=0), axis=1).max() < 0.25 * np.linalg.norm(turns, axis=1).mean()


@settings(max_examples=15, deadline=None)
@given(similarities())
def test_the_same_in_any_world(similarity: Similarity) -> None:
    cameras = shaken(arc(TARGET, views=12, degrees=200))
    path, carried = (camera_path(each, NO_POINTS, 10) for each in (cameras, moved(cameras, similarity)))
    there = similarity.points(path.centres())
    back = min((carried.centres(), carried.centres()[::-1]), key=lambda centres: np.abs(centres - there).max())
    np.testing.assert_allclose(back, there, atol=1e-3 * similarity.scale, rtol=1e-3)


def test_a_camera_that_only_turns() -> None:
    """It stays in one place, so the speed is that of its turning."""
    poses = np.tile(np.eye(4), (9, 1, 1))
    angles = np.linspace(-1, 1, 9)
    poses[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * [0, 1, 0]).as_matrix()
    cameras = replace(arc(TARGET, views=9), world_to_camera=poses)
    path = camera_path(cameras, np.array([[0.0, 0.0, 5.0]]), 12)
    np.testing.assert_allclose(path.centres(), 0, atol=1e-9)
    directions = path.world_to_camera[:, 2, :3]
    turns = np.degrees(np.arccos((directions[1:] * directions[:-1]).sum(axis=1)))
    np.testing.assert_allclose(turns, turns.mean(), rtol=0.02)
    assert turns.sum() > 90


@pytest.mark.parametrize("shaking", [0.0, 0.001, 0.02, 0.1])
def test_a_room_seen_from_one_place_is_turned_through_once(shaking: float) -> None:
    """However the hand that turns the camera shakes, which is where the optical axes meet."""
    random = np.random.default_rng(0)
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None] * [0, 1, 0]).as_matrix()
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, :3] = turns
    poses[:, :3, 3] = random.normal(scale=shaking, size=(60, 3))
    around = random.normal(size=(500, 3)) * [1, 0.3, 1]
    walls = 3 * around / np.linalg.norm(around, axis=1, keepdims=True)
    path = camera_path(replace(arc(TARGET, views=60), world_to_camera=poses), walls, 48)
    directions = path.world_to_camera[:, 2, :3]
    turned = np.degrees(np.arccos(np.clip((directions[1:] * directions[:-1]).sum(axis=1), -1, 1)))
    assert turned.sum() < 400
    assert turned.max() < 12


@pytest.mark.parametrize("views", [20, 41, 63, 88, 120])
def test_a_turntable_that_ends_where_it_began(views: int) -> None:
    """The last camera is the first but for rounding: a step too short to lengthen the path."""
    angles = np.linspace(0, 2 * np.pi, views)
    centres = np.stack([4 * np.cos(angles), np.full(views, 1.2), 4 * np.sin(angles)], axis=1)
    views_of = -centres / np.linalg.norm(centres, axis=1, keepdims=True)
    right = np.cross(np.array([0.0, -1, 0]), views_of)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(views_of, right), views_of], axis=1)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], centres)
    path = camera_path(replace(arc(TARGET, views=views), world_to_camera=poses), NO_POINTS, 40)
    assert np.isfinite(path.world_to_camera).all()
    np.testing.assert_allclose(np.linalg.norm(path.centres()[:, [0, 2]], axis=1), 4.0, rtol=0.03)


def test_straight_down_there_is_no_horizon_to_keep() -> None:
    """Cameras above a plane, like a drone's: the pictures keep the cameras' own rotation about the view."""
    poses = np.tile(np.diag([1.0, -1, -1, 1]), (16, 1, 1))
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], np.concatenate([grid, np.full((16, 1), 3.0)], axis=1))
    cameras = replace(arc(TARGET, views=16), world_to_camera=poses)
    path = camera_path(cameras, NO_POINTS, 20)
    np.testing.assert_allclose(path.world_to_camera[:, :3, :3], np.diag([1.0, -1, -1])[None].repeat(20, 0), atol=1e-6)


def test_over_the_top_the_picture_does_not_whirl() -> None:
    """A ring, and cameras above it that look almost straight down, where a level horizon could turn at any speed."""
    ring = arc(TARGET, views=16)
    above = np.tile(np.diag([1.0, -1, -1, 1]), (5, 1, 1))
    centres = TARGET + np.stack([np.linspace(-1, 1, 5), np.zeros(5), np.full(5, 4.0)], axis=1)
    tilts = Rotation.from_rotvec(np.random.default_rng(0).normal(scale=0.1, size=(5, 3))).as_matrix()
    above[:, :3, :3] = tilts @ above[:, :3, :3]
    above[:, :3, 3] = -np.einsum("vij,vj->vi", above[:, :3, :3], centres)
    both = Cameras(
        tuple(f"{view:03d}" for view in range(21)),
        np.concatenate([ring.world_to_camera, above]),
        ring.intrinsics[:1].repeat(21, 0),
        ring.width,
        ring.height,
    )
    path = camera_path(both, NO_POINTS, 200)
    rotations = Rotation.from_matrix(path.world_to_camera[:, :3, :3])
    turns = np.degrees((rotations[1:] * rotations[:-1].inv()).magnitude())
    assert (path.world_to_camera[:, 2, 2] < -0.98).any(), "it does look down"
    assert turns.max() < 12


@pytest.mark.parametrize("views", [1, 2, 3])
def test_few_cameras(views: int) -> None:
    cameras = arc(TARGET, views=views, degrees=90)
    path = camera_path(cameras, NO_POINTS, 8)
    assert len(path) == 8
    assert np.isfinite(path.world_to_camera).all()
    if views == 1:
        np.testing.assert_allclose(path.world_to_camera, cameras.world_to_camera.repeat(8, 0), atol=1e-6)


def test_cameras_in_one_place_stand_still() -> None:
    one = arc(TARGET, views=1).world_to_camera
    path = camera_path(replace(arc(TARGET, views=6), world_to_camera=one.repeat(6, 0)), NO_POINTS, 5)
    np.testing.assert_allclose(path.world_to_camera, one.repeat(5, 0), atol=1e-6)


def test_the_lens_is_the_median_and_sides_are_even() -> None:
    cameras = arc(TARGET, views=9, size=(95, 71))
    intrinsics = cameras.intrinsics.copy()
    intrinsics[0, 0, 0] = 900
    path = camera_path(replace(cameras, intrinsics=intrinsics), NO_POINTS, 4)
    assert (path.width, path.height) == (96, 72)
    np.testing.assert_array_equal(path.intrinsics, cameras.intrinsics[:1].repeat(4, 0))
    assert len(set(path.names)) == 4


def test_what_makes_no_path_is_refused() -> None:
    cameras = arc(TARGET, views=4)
    for wrong in ({"frames": 0}, {"frames": 4, "bends": 0}):
        with pytest.raises(ValueError, match="path"):
            camera_path(cameras, NO_POINTS, **wrong)
    with pytest.raises(ValueError, match="0 cameras"):
        camera_path(cameras.select([]), NO_POINTS, 4)
