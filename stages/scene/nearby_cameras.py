"""Cameras near those of a rig: what else of a scene can be rendered from about where photos were taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from stages.scene.alignment import rig_of
from stages.scene.cameras import Cameras

LARGEST_STEP = 0.15
"""Along each axis, as a share of the distance that the rig looks at."""

LARGEST_TURN = 0.15
"""About each axis, in radians."""

LARGEST_ZOOM = 1.3


def with_cameras_nearby(cameras: Cameras, points: Float[np.ndarray, "P 3"], each: int, seed: int) -> Cameras:
    """The rig, and then `each` cameras beside every one of it, moved, turned and zoomed at random.

    Steps and turns are even up to the largest, zooms even in their logarithm. `points` of the scene (P = 0 is allowed)
    only tell how far parallel cameras look. Raises `ValueError` without cameras.
    """
    generator = np.random.default_rng(seed)
    count = each * len(cameras)
    farthest = LARGEST_STEP * rig_of(cameras, points).distance
    centres = np.tile(cameras.centres(), (each, 1)) + generator.uniform(-farthest, farthest, (count, 3))
    turns = Rotation.from_rotvec(generator.uniform(-LARGEST_TURN, LARGEST_TURN, (count, 3))).as_matrix()
    world_to_camera = np.tile(cameras.world_to_camera, (each, 1, 1))
    world_to_camera[:, :3, :3] = turns @ world_to_camera[:, :3, :3]
    world_to_camera[:, :3, 3] = -np.einsum("vij,vj->vi", world_to_camera[:, :3, :3], centres)
    intrinsics = np.tile(cameras.intrinsics, (each, 1, 1))
    zooms = LARGEST_ZOOM ** generator.uniform(-1, 1, count)
    intrinsics[:, 0, 0] *= zooms
    intrinsics[:, 1, 1] *= zooms
    return replace(
        cameras,
        names=(*cameras.names, *[f"nearby {number}" for number in range(count)]),
        world_to_camera=np.concatenate([cameras.world_to_camera, world_to_camera]),
        intrinsics=np.concatenate([cameras.intrinsics, intrinsics]),
    )
