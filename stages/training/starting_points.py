"""Where the first Gaussians are: on the sparse points of SfM, and in the space before the cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from pipeline.errors import UserError
from stages.scene.scene import Scene

GREY = 0.5
DEPTH_PERCENTILES = (1, 99)
NEARER, FARTHER = 0.7, 2.0
"""Random points may lie this much nearer and farther than the sparse points that a camera sees."""

Points = Float[np.ndarray, "N 3"]


def starting_points(scene: Scene, sparse: bool, random_points: int, seed: int) -> tuple[Points, Points]:
    """Positions in world units, and sRGB colours in [0, 1], of the first Gaussians.

    The sparse points with their colours, if wanted, then `random_points` grey ones. Raises `UserError` for a scene
    without sparse points: without them nothing says how far from the cameras its things are.
    """
    if len(scene.points) == 0:
        raise UserError(
            "the scene has no sparse points to start from",
            found="0 points",
            expected="at least one",
            remedy="check the capture's poses, or photograph with more overlap",
        )
    scattered = points_before_cameras(scene, random_points, np.random.default_rng(seed))
    grey = np.full_like(scattered, GREY)
    if not sparse:
        return scattered, grey
    points = np.concatenate([scene.points.astype(np.float64), scattered])
    return points, np.concatenate([scene.point_colors / 255, grey])


def points_before_cameras(scene: Scene, count: int, generator: np.random.Generator) -> Points:
    """`count` points that the training cameras see, uniform over views, pixels and inverse depth.

    They know nothing of a message, so that they can serve it without betraying its shape.
    """
    cameras = scene.cameras.select(scene.train_names or scene.cameras.names)
    views = generator.integers(len(cameras), size=count)
    pixels = generator.uniform(0, 1, (count, 2)) * (cameras.width, cameras.height)
    limits = np.array([_depth_limits(scene.points, pose) for pose in cameras.world_to_camera]).reshape(-1, 2)
    nearest, farthest = limits[views].T
    depths = 1 / generator.uniform(1 / farthest, 1 / nearest)
    homogeneous = np.concatenate([pixels, np.ones((count, 1))], axis=1)
    rays = np.einsum("nij,nj->ni", np.linalg.inv(cameras.intrinsics)[views], homogeneous)
    poses = cameras.world_to_camera[views]
    return np.einsum("nij,ni->nj", poses[:, :3, :3], rays * depths[:, None] - poses[:, :3, 3])


def _depth_limits(points: Points, world_to_camera: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
    depths = points @ world_to_camera[2, :3] + world_to_camera[2, 3]
    before = depths[depths > 0]
    if len(before) == 0:
        before = np.abs(depths) + np.finfo(float).tiny
    nearest, farthest = np.percentile(before, DEPTH_PERCENTILES)
    return NEARER * nearest, FARTHER * farthest
