"""Directions of pixels agree with the projection of points; the extent of a rig."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from stages.scene.alignment import project
from stages.scene.cameras import Cameras, depths_before, pixel_directions, rig_extent, single_cameras
from stages.tracing.rig import orbit

SIZE = (20, 14)


def test_a_point_along_a_pixels_direction_is_seen_in_that_pixel() -> None:
    cameras = Cameras(("a", "b"), *orbit(2, *SIZE, seed=0), *SIZE)
    for index, camera in enumerate(single_cameras(cameras)):
        directions = pixel_directions(camera)
        assert directions.shape == (14, 20, 3)
        torch.testing.assert_close(directions.norm(dim=-1), torch.ones(14, 20))
        points = camera.centre + 3 * directions.reshape(-1, 3)
        pixels, depth = project(cameras.select([cameras.names[index]]), points.double().numpy())
        expected = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(14) + 0.5), axis=-1).reshape(-1, 2)
        assert (depth > 0).all()
        np.testing.assert_allclose(pixels[0], expected, atol=1e-3)


def test_a_rig_extends_as_far_as_its_farthest_camera() -> None:
    """Lengths are divided by the extent, so it is 1 if all cameras are in one place."""
    assert rig_extent(standing_at([[-1, 0, 0], [1, 0, 0], [0, 2, 0]])) == pytest.approx(1.1 * 4 / 3)
    assert rig_extent(standing_at([[1, 2, 3]])) == rig_extent(standing_at([[0.1, 0.7, 0.3]] * 3)) == 1.0
    assert rig_extent(standing_at([[0, 0, 0]] * 3)) == 1.0


def test_each_selected_camera_keeps_its_pose_and_its_intrinsics() -> None:
    world_to_camera, intrinsics = orbit(3, *SIZE, seed=0)
    intrinsics[:, 0, 0] += np.arange(3)
    chosen = Cameras(("a", "b", "c"), world_to_camera, intrinsics, *SIZE).select(["c", "a"])
    assert chosen.names == ("c", "a")
    np.testing.assert_array_equal(chosen.world_to_camera, world_to_camera[[2, 0]])
    np.testing.assert_array_equal(chosen.intrinsics, intrinsics[[2, 0]])


def test_a_point_has_the_same_depth_before_one_camera_as_before_its_rig() -> None:
    cameras = Cameras(("a", "b"), *orbit(2, *SIZE, seed=0), *SIZE)
    points = np.random.default_rng(0).normal(size=(7, 3))
    _, depths = project(cameras, points)
    for camera, expected in zip(single_cameras(cameras), depths, strict=True):
        found = depths_before(torch.from_numpy(points).float(), camera)
        np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("field", ["world_to_camera", "intrinsics"])
def test_a_camera_that_is_not_finite_is_named(field: str, value: float) -> None:
    arrays = dict(zip(("world_to_camera", "intrinsics"), orbit(3, *SIZE, seed=0), strict=True))
    arrays[field][1, 0, 0] = value
    with pytest.raises(UserError, match=f"b: a camera's {field} is not finite"):
        Cameras(("a", "b", "c"), **arrays, width=20, height=14)


def standing_at(centres: list[list[float]]) -> Cameras:
    poses = np.tile(np.eye(4), (len(centres), 1, 1))
    poses[:, :3, 3] = -np.array(centres)
    names = tuple(str(number) for number in range(len(centres)))
    return Cameras(names, poses, np.tile(np.eye(3), (len(centres), 1, 1)), *SIZE)
