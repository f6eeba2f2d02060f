"""The camera path: one closed orbit of the scene that rises and falls three times."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

RADIUS = 4.1
ELEVATION = 23.0
ELEVATION_SWING = 8.0
LOOK_AT_HEIGHT = 0.75
FOCAL_RATIO = 0.92
"""Focal length over picture width: a horizontal field of view of about 57 degrees."""


def orbit(
    views: int, width: int, height: int, seed: int
) -> tuple[Float64[np.ndarray, "V 4 4"], Float64[np.ndarray, "V 3 3"]]:
    """World-to-camera matrices and pixel intrinsics of V inward-facing cameras; z is up in the world.

    The views are in order along a closed path: the last is next to the first, so no view is at an end. Step, height,
    distance, aim and tilt vary slightly, as in handheld photos.
    """
    generator = np.random.default_rng([seed, 41])
    sway = generator.uniform(-1, 1, (views, 6))
    azimuth = 2 * np.pi * (np.arange(views) + 0.15 * sway[:, 0]) / views
    elevation = np.radians(ELEVATION + ELEVATION_SWING * np.sin(3 * azimuth) + 0.6 * sway[:, 1])
    radius = RADIUS + 0.2 * np.sin(2 * azimuth + 1) + 0.04 * sway[:, 2]
    ring = radius * np.cos(elevation)
    centres = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), radius * np.sin(elevation)], axis=1)
    targets = np.stack([0.08 * sway[:, 3], 0.08 * sway[:, 4], np.full(views, LOOK_AT_HEIGHT)], axis=1)
    tilts = np.radians(1.5) * sway[:, 5]
    poses = [look_at(*one) for one in zip(centres, targets, tilts, strict=True)]
    focal = FOCAL_RATIO * width
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return np.array(poses).reshape(-1, 4, 4), np.tile(intrinsics, (views, 1, 1))


def look_at(
    centre: Float64[np.ndarray, " 3"], target: Float64[np.ndarray, " 3"], tilt: float = 0.0
) -> Float64[np.ndarray, "4 4"]:
    """World-to-camera pose (x right, y down, z forward) at `centre`, looking at `target`, rolled by `tilt` radians."""
    forward = target - centre
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(tilt), np.sin(tilt)
    rotation = np.stack([cosine * right + sine * down, cosine * down - sine * right, forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ centre
    return pose
