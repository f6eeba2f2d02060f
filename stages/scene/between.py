"""Cameras between those of a rig: views that nobody photographed, as near to photos as photos are to each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from stages.scene.cameras import Cameras

NEIGHBOURS = 8
"""The second camera is one of this many nearest to the first."""


def cameras_between(cameras: Cameras, count: int, generator: np.random.Generator) -> Cameras:
    """`count` cameras, each at a random fraction of the way from a random camera to itself or one of its nearest.

    Centres are interpolated linearly, rotations along the shortest turn (slerp); the intrinsics are the first camera's.
    Names are numbers. A single camera is repeated. Raises `ValueError` if `count` > 0 but there are no cameras.
    """
    if count and not len(cameras):
        raise ValueError(f"{count} cameras between none")
    centres, rotations = cameras.centres(), cameras.world_to_camera[:, :3, :3]
    poses = np.tile(np.eye(4), (count, 1, 1))
    first = generator.integers(len(cameras), size=count) if count else np.zeros(0, int)
    for number, one in enumerate(first):
        nearest = np.argsort(np.linalg.norm(centres - centres[one], axis=1), kind="stable")[: NEIGHBOURS + 1]
        other, share = int(generator.choice(nearest)), generator.random()
        turned = Slerp([0, 1], Rotation.from_matrix(rotations[[one, other]]))(share).as_matrix()
        poses[number, :3, :3] = turned
        poses[number, :3, 3] = -turned @ ((1 - share) * centres[one] + share * centres[other])
    names = tuple(f"{number:04d}" for number in range(count))
    return Cameras(names, poses, cameras.intrinsics[first], cameras.width, cameras.height)
