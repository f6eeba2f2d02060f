"""Positions of the first Gaussians: sparse points of SfM, and random points in the space in front of the cameras.

3DGS and the paper start from the cover's points. These say nothing about where the message's surfaces are, and density
control only grows from existing Gaussians: without the message's points, it is fitted view by view and missing from new
views.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from pipeline.errors import UserError
from stages.hiding.rendering import COVER
from stages.scene.alignment import nearest_depth
from stages.scene.message_views import MessagePictures
from stages.scene.scene import Scene

GREY = 0.5
RANDOM = ""
"""The name under which random points are listed; no picture has it."""

CLEAR_SHARE = 0.75
"""Smallest distance of a message's points from any training camera, relative to the nearest depth of the cover. With 1,
a tenth of the kitchen's points are left among the bonsai's cameras, which surround it; with 0.5, the fox loses 0.7 dB.
"""

DEPTH_PERCENTILES = (1, 99)
NEARER, FARTHER = 0.7, 2.0
"""Factors by which random points may be nearer and farther than the sparse points in front of a camera, visible or
not."""

Points = Float[np.ndarray, "N 3"]


@dataclass(frozen=True)
class Start:
    """Which points to start from.

    These are the cover's sparse points, the first `message_points` of each message's points that are clear of the
    cameras, and `random_points` random ones.
    """

    sparse_points: bool
    message_points: int
    random_points: int
    seed: int


def starting_points(
    scene: Scene, messages: Mapping[str, MessagePictures], start: Start
) -> tuple[Points, dict[str, Points]]:
    """World positions [N, 3] of the first Gaussians, and their colours [N, 3] in every picture, by its name.

    Points of the cover are grey in the messages, and vice versa; random points are grey everywhere. Raises `UserError`
    for a scene without sparse points, since nothing else says how far from the cameras its surfaces are, and if no
    point is requested.
    """
    if len(scene.points) == 0:
        raise UserError(
            "the scene has no sparse points to start from",
            found="0 points",
            expected="at least one",
            remedy="check the capture's poses, or photograph with more overlap",
        )
    generator = np.random.default_rng(start.seed)
    clouds: list[tuple[str, Points, Points]] = []
    if start.sparse_points:
        clouds.append((COVER, scene.points.astype(np.float64), scene.point_colors / 255))
    for name, views in messages.items():
        first = clear_of_cameras(scene, views.points)[: start.message_points]
        clouds.append((name, views.points[first].astype(np.float64), views.point_colors[first] / 255))
    scattered = points_before_cameras(scene, start.random_points, generator)
    clouds.append((RANDOM, scattered, np.full_like(scattered, GREY)))
    positions = np.concatenate([points for _, points, _ in clouds])
    if len(positions) == 0:
        raise UserError(
            "there are no Gaussians to start from; density control only adds to existing ones",
            found="no sparse, random or message points",
            expected="at least one Gaussian",
            remedy="leave sparse_points on, or set random_points above 0",
        )
    return positions, {
        picture: np.concatenate(
            [colors if name == picture else np.full_like(colors, GREY) for name, _, colors in clouds]
        )
        for picture in (COVER, *messages)
    }


def clear_of_cameras(scene: Scene, points: Points) -> Int[np.ndarray, " K"]:
    """Indices of the points that are far enough from all training cameras.

    A message's surface right in front of a camera would veil the cover there, and few other cameras could correct it.
    With such points, the kitchen's table veiled two of the fox's seven test views; one of them lost 12 dB.
    """
    if len(points) == 0:
        return np.zeros(0, np.int64)
    cameras = scene.training_cameras
    distances, _ = cKDTree(cameras.centres()).query(points)
    return np.flatnonzero(distances >= CLEAR_SHARE * nearest_depth(cameras, scene.points))


def points_before_cameras(scene: Scene, count: int, generator: np.random.Generator) -> Points:
    """`count` points that the training cameras see, uniform over views, pixels and inverse depth.

    They do not depend on any message, so they can serve one without revealing its shape.
    """
    if count == 0:  # the depths of all points before all cameras take seconds
        return np.zeros((0, 3))
    cameras = scene.training_cameras
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
