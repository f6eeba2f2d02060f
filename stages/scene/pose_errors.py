"""Errors of estimated cameras, up to the similarity that structure from motion cannot determine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from stages.scene.cameras import Cameras
from stages.scene.similarity import Similarity, fit_similarity


@dataclass(frozen=True)
class PoseErrors:
    """Errors of V cameras: positions as a fraction of the true rig's radius, rotations in degrees."""

    position: Float[np.ndarray, " V"]
    rotation: Float[np.ndarray, " V"]


def rig_radius(cameras: Cameras) -> float:
    """The median distance of the cameras from their mean, in world units; 0 without cameras."""
    if not len(cameras):
        return 0.0
    centres = cameras.centres()
    return float(np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))


def shared_cameras(estimated: Cameras, true: Cameras) -> tuple[Cameras, Cameras]:
    """The cameras of both rigs whose names both have, sorted by name."""
    names = sorted(set(estimated.names) & set(true.names))
    return estimated.select(names), true.select(names)


def align_cameras(estimated: Cameras, true: Cameras) -> Similarity:
    """The similarity from the estimated world into the true one, fitted to the centres of shared cameras.

    Raises `ValueError` for fewer than three shared cameras, or if all of them coincide.
    """
    estimated, true = shared_cameras(estimated, true)
    return fit_similarity(estimated.centres(), true.centres())


def pose_errors(estimated: Cameras, true: Cameras) -> PoseErrors:
    """Errors of the cameras that both rigs share, after `align_cameras`; raises as it does."""
    estimated, true = shared_cameras(estimated, true)
    similarity = align_cameras(estimated, true)
    distance = np.linalg.norm(similarity.points(estimated.centres()) - true.centres(), axis=1)
    moved = similarity.world_to_camera(estimated.world_to_camera)
    between = moved[:, :3, :3] @ true.world_to_camera[:, :3, :3].transpose(0, 2, 1)
    return PoseErrors(distance / rig_radius(true), rotation_angles(between))


def rotation_angles(rotations: Float[np.ndarray, "V 3 3"]) -> Float[np.ndarray, " V"]:
    """Rotation angles in degrees, 0 to 180; accurate for small angles too."""
    skew = rotations - rotations.transpose(0, 2, 1)
    sine = np.linalg.norm(np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1), axis=1) / 2
    cosine = (np.trace(rotations, axis1=1, axis2=2) - 1) / 2
    return np.degrees(np.arctan2(sine, cosine))
