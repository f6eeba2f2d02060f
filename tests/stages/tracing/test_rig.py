"""The cameras' walk: true rotations, +z forward, y down, one closed loop of small steps."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.rig import LOOK_AT_HEIGHT, RADIUS, look_at, orbit


def centres(poses: np.ndarray) -> np.ndarray:
    return -np.einsum("vij,vi->vj", poses[:, :3, :3], poses[:, :3, 3])


def test_poses_are_rigid() -> None:
    poses, intrinsics = orbit(48, 512, 384, 0)
    rotation = poses[:, :3, :3]
    assert poses.dtype == intrinsics.dtype == np.float64
    assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(rotation), 1)
    assert np.allclose(poses[:, 3], [0, 0, 0, 1])


def test_every_camera_sees_the_middle_of_the_scene() -> None:
    poses, intrinsics = orbit(48, 512, 384, 3)
    middle = np.einsum("vij,j->vi", poses, [0, 0, LOOK_AT_HEIGHT, 1])[:, :3]
    assert (middle[:, 2] > 3).all()  # in front, along +z
    pixel = np.einsum("vij,vj->vi", intrinsics, middle)
    assert np.abs(pixel[:, :2] / pixel[:, 2:] - [256, 192]).max() < 20


def test_up_in_the_world_is_up_in_the_picture() -> None:
    poses, _ = orbit(48, 512, 384, 0)
    low = np.einsum("vij,j->vi", poses, [0, 0, 0.0, 1])
    high = np.einsum("vij,j->vi", poses, [0, 0, 1.0, 1])
    assert (high[:, 1] < low[:, 1]).all()


def test_the_walk_is_closed_and_its_steps_are_small() -> None:
    place = centres(orbit(48, 512, 384, 0)[0])
    steps = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1)
    assert steps.max() < 0.2 * RADIUS
    assert steps.min() > 0.05 * RADIUS
    assert np.abs(np.linalg.norm(place, axis=1) - RADIUS).max() < 0.1 * RADIUS
    assert np.ptp(place[:, 2]) > 0.2 * RADIUS


def test_the_seed_moves_the_hand_only_a_little() -> None:
    first, second = (centres(orbit(48, 512, 384, seed)[0]) for seed in (0, 1))
    assert not np.allclose(first, second)
    assert np.linalg.norm(first - second, axis=1).max() < 0.1 * RADIUS
    assert np.array_equal(first, centres(orbit(48, 512, 384, 0)[0]))


def test_look_at_without_tilt_keeps_the_horizon_level() -> None:
    pose = look_at(np.array([3.0, -1.0, 2.0]), np.array([0.2, 0.1, 0.5]))
    assert pose[0, 2] == pytest.approx(0)  # the camera's right is horizontal
    assert np.allclose((pose @ [0.2, 0.1, 0.5, 1])[:2], 0)
