"""Directions of pixels agree with where points are projected."""

from __future__ import annotations

import numpy as np
import torch

from stages.scene.alignment import project
from stages.scene.cameras import Cameras, pixel_directions, single_cameras
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
