"""Directions of pixels agree with the projection of points; the extent of a rig."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.scene.alignment import project
from stages.scene.cameras import Cameras, pixel_directions, rig_extent, single_cameras
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


def standing_at(centres: list[list[float]]) -> Cameras:
    poses = np.tile(np.eye(4), (len(centres), 1, 1))
    poses[:, :3, 3] = -np.array(centres)
    names = tuple(str(number) for number in range(len(centres)))
    return Cameras(names, poses, np.tile(np.eye(3), (len(centres), 1, 1)), *SIZE)
