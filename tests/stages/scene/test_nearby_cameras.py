"""Nearby cameras stay near, follow from the seed, and look about where the rig looks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stages.scene.alignment import rig_of
from stages.scene.nearby_cameras import LARGEST_STEP, LARGEST_TURN, with_cameras_nearby
from stages.scene.scene import read_scene
from tests.stages import small


def test_cameras_nearby_are_near(tmp_path: Path) -> None:
    scene = read_scene(small.scene(tmp_path / "scene"))
    rig = scene.cameras
    made = with_cameras_nearby(rig, scene.points, 3, seed=0)
    assert len(made) == 4 * len(rig)
    np.testing.assert_array_equal(made.world_to_camera[: len(rig)], rig.world_to_camera)
    steps = made.centres() - np.tile(rig.centres(), (4, 1))
    assert 0 < np.abs(steps).max() <= LARGEST_STEP * rig_of(rig, scene.points).distance + 1e-9
    views = made.world_to_camera[:, 2, :3]
    assert (views * np.tile(rig.world_to_camera[:, 2, :3], (4, 1))).sum(axis=1).min() > np.cos(3**0.5 * LARGEST_TURN)
    again, other = (with_cameras_nearby(rig, scene.points, 3, seed) for seed in (0, 1))
    np.testing.assert_array_equal(again.intrinsics, made.intrinsics)
    assert not np.array_equal(other.intrinsics, made.intrinsics)
