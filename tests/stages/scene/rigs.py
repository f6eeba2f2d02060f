"""Rigs of cameras and random similarities for tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.scene.cameras import Cameras
from stages.scene.similarity import Similarity


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """World to camera of a level camera at `centre` that sees `target` in its middle; z is up."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return pose


def arc(
    target: np.ndarray,
    *,
    views: int = 16,
    degrees: float = 360.0,
    radius: float = 4.0,
    height: float = 1.5,
    size: tuple[int, int] = (96, 72),
    focal: float = 90.0,
) -> Cameras:
    """Cameras on an arc about `target`, centred on the side of +x, all looking at it."""
    azimuth = np.radians(np.linspace(-degrees / 2, degrees / 2, views, endpoint=degrees < 360))
    offsets = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full(views, height)], axis=1)
    poses = np.array([look_at(target + offset, target) for offset in offsets])
    intrinsics = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return Cameras(tuple(f"{view:03d}" for view in range(views)), poses, np.tile(intrinsics, (views, 1, 1)), *size)


def moved(cameras: Cameras, similarity: Similarity) -> Cameras:
    """The rig, carried along with its world."""
    poses = similarity.world_to_camera(cameras.world_to_camera)
    return Cameras(cameras.names, poses, cameras.intrinsics, cameras.width, cameras.height)


@st.composite
def similarities(draw: st.DrawFn) -> Similarity:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = draw(st.floats(0.05, 20.0))
    return Similarity(scale, Rotation.random(random_state=random).as_matrix(), random.normal(size=3) * 5)
