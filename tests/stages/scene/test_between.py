"""Cameras between others lie and look between two of them, and are the same again with the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.scene.between import NEIGHBOURS, cameras_between
from stages.scene.cameras import Cameras


def rig(count: int, seed: int = 0) -> Cameras:
    generator = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(generator.normal(0, 0.5, (count, 3))).as_matrix()
    poses[:, :3, 3] = generator.normal(0, 2, (count, 3))
    intrinsics = np.tile(np.array([[30.0, 0, 10], [0, 30.0, 8], [0, 0, 1]]), (count, 1, 1))
    intrinsics[:, 0, 0] += np.arange(count)
    return Cameras(tuple(f"{number}.png" for number in range(count)), poses, intrinsics, 20, 16)


@given(count=st.integers(1, 12), seed=st.integers(0, 100))
def test_each_is_on_the_way_from_one_to_one_of_its_nearest(count: int, seed: int) -> None:
    cameras = rig(count, seed)
    found = cameras_between(cameras, 5, np.random.default_rng(seed))
    assert len(found) == 5
    assert (found.width, found.height) == (cameras.width, cameras.height)
    centres, rotations = cameras.centres(), Rotation.from_matrix(cameras.world_to_camera[:, :3, :3])
    for centre, pose, lens in zip(found.centres(), found.world_to_camera, found.intrinsics, strict=True):
        one = int(lens[0, 0] - 30)
        nearest = np.argsort(np.linalg.norm(centres - centres[one], axis=1), kind="stable")[: NEIGHBOURS + 1]
        ways = centres[nearest] - centres[one]
        lengths = np.linalg.norm(ways, axis=1) + np.linalg.norm(centre - centres[nearest], axis=1)
        detours = np.linalg.norm(centre - centres[one]) + np.linalg.norm(centre - centres[nearest], axis=1)
        detours -= np.linalg.norm(ways, axis=1)
        other = nearest[int(np.argmin(detours))]
        assert detours.min() < 1e-9 * (1 + lengths.max())
        turned = Rotation.from_matrix(pose[:3, :3])
        whole = (rotations[other] * rotations[one].inv()).magnitude()
        assert (turned * rotations[one].inv()).magnitude() <= whole + 1e-6
        assert (turned * rotations[other].inv()).magnitude() <= whole + 1e-6


def test_the_seed_decides_and_none_are_none() -> None:
    cameras = rig(4)
    first, again, other = (cameras_between(cameras, 6, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.world_to_camera, again.world_to_camera)
    assert not np.allclose(first.world_to_camera, other.world_to_camera)
    nothing = replace(cameras, names=(), world_to_camera=np.zeros((0, 4, 4)), intrinsics=np.zeros((0, 3, 3)))
    assert len(cameras_between(cameras, 0, np.random.default_rng(0))) == 0
    assert len(cameras_between(nothing, 0, np.random.default_rng(0))) == 0
    with pytest.raises(ValueError, match="3 cameras between none"):
        cameras_between(nothing, 3, np.random.default_rng(0))
