"""Checks on cameras from untrusted sources."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.errors import UserError
from stages.scene.cameras import ROUNDING, Cameras

ROTATION_TOLERANCE = 1e-3
"""Largest entry of R Rᵀ - I for a rotation R."""
FARTHEST = 2700
"""Largest distance of a rig's middle from the world's origin, in extents of the rig. Training uses float32, which
rounds a coordinate x by up to x / 2^24, and first moves Gaussians by 1.6e-4 extents a step. Beyond 1.6e-4 * 2^24 = 2684
extents, a step may change nothing, and at a focal length of 1000 pixels a point one extent away is 0.16 pixels off."""


def are_cameras(cameras: Cameras) -> Bool[np.ndarray, " V"]:
    """Whether each camera has positive focal lengths and a rigid pose (no scale, shear or reflection)."""
    rotations, intrinsics = cameras.world_to_camera[:, :3, :3], cameras.intrinsics
    turned = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < ROTATION_TOLERANCE
    focal = (intrinsics[:, 0, 0] > 0) & (intrinsics[:, 1, 1] > 0)
    return focal & turned & (np.linalg.det(rotations) > 0)


def refuse_far_poses(world_to_camera: Float64[np.ndarray, "V 4 4"], where: Path) -> None:
    """Raise `UserError` if the cameras from `where` are so far from the origin that float32 cannot tell them apart.

    Their coordinates may be a national grid's (UTM) or geocentric (ECEF), in metres. Cameras that all coincide pass.
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
