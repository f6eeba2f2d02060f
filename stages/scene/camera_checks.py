"""Whether cameras that came from anywhere are cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.errors import UserError
from stages.scene.cameras import ROUNDING, Cameras

ROTATION_TOLERANCE = 1e-3
"""By how much the product of a rotation and its transpose may differ from the identity."""
FARTHEST = 2700
"""How many extents of a rig its middle may lie off the world's origin: training is in float32, which rounds a
coordinate x by up to x / 2^24, and moves Gaussians by 1.6e-4 extents a step at first. From 1.6e-4 * 2^24 = 2684 extents
on a step may change nothing, and at a depth of one extent a focal length of 1000 pixels errs by 0.16 of a pixel."""


def are_cameras(cameras: Cameras) -> Bool[np.ndarray, " V"]:
    """Of each whether it has focal lengths, and a pose that turns and moves and does nothing else."""
    rotations, intrinsics = cameras.world_to_camera[:, :3, :3], cameras.intrinsics
    turned = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < ROTATION_TOLERANCE
    focal = (intrinsics[:, 0, 0] > 0) & (intrinsics[:, 1, 1] > 0)
    return focal & turned & (np.linalg.det(rotations) > 0)


def refuse_far_poses(world_to_camera: Float64[np.ndarray, "V 4 4"], where: Path) -> None:
    """Raise `UserError` for cameras that came from `where` and stand so far off that float32 cannot tell them apart.

    Such as those in metres of a national grid (UTM) or from the middle of the Earth (ECEF).
    """
    rotations, translations = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]
    centres = -np.einsum("vij,vi->vj", rotations, translations)
    middle = centres.mean(axis=0)
    extent, distance = np.linalg.norm(centres - middle, axis=1).max(), np.linalg.norm(middle)
    if distance <= FARTHEST * extent or extent <= ROUNDING * distance:
        return
    where_it_is = ", ".join(f"{value:.10g}" for value in middle)
    raise UserError(
        "the cameras stand too far from the origin of their world, as in coordinates of a map",
        where=where,
        found=f"their middle at ({where_it_is}), all within {extent:.3g} units of it",
        expected=f"a middle at most {FARTHEST * extent:.3g} units off the origin: farther off, training in float32 "
        "cannot tell them apart",
        remedy="Move the origin there: subtract that middle from the positions of all cameras (in a COLMAP model those "
        "are -Rᵀt). Or take the poses out of the folder to have them estimated.",
    )
