"""Whether cameras that came from anywhere are cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from stages.scene.cameras import Cameras

ROTATION_TOLERANCE = 1e-3
"""By how much the product of a rotation and its transpose may differ from the identity."""


def are_cameras(cameras: Cameras) -> Bool[np.ndarray, " V"]:
    """Of each whether it has focal lengths, and a pose that turns and moves and does nothing else."""
    rotations, intrinsics = cameras.world_to_camera[:, :3, :3], cameras.intrinsics
    turned = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < ROTATION_TOLERANCE
    focal = (intrinsics[:, 0, 0] > 0) & (intrinsics[:, 1, 1] > 0)
    return focal & turned & (np.linalg.det(rotations) > 0)
