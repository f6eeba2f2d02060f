"""Coordinates that need no measuring: those of a rig of cameras, and those of splats that have none."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from stages.scene.alignment import Rig
from stages.scene.similarity import Similarity

SPREAD = 0.9
"""The share of splats' centres that lie within 1 of the middle, in coordinates of their own."""


def rig_frame(rig: Rig) -> Similarity:
    """From the coordinates of a rig to the world.

    The origin is the point that the cameras look at; x points to the right and y forwards, as the mean camera sees it
    with a level horizon, and z upwards. 1 is the median distance of the cameras from the origin.
    """
    axes = np.stack([np.cross(rig.forward, rig.up), rig.forward, rig.up], axis=1)
    return Similarity(rig.distance, axes, rig.focus)


def splats_frame(means: Float[np.ndarray, "N 3"]) -> Similarity:
    """The like for splats without cameras, whose world has y downwards, as COLMAP's and most of 3DGS have.

    The origin is the median of the centres, and 90 % of them lie within 1 of it. Raises `ValueError` for N = 0.
    """
    if not len(means):
        raise ValueError("no splats have no middle")
    middle = np.median(means, axis=0).astype(np.float64)
    distance = float(np.quantile(np.linalg.norm(means - middle, axis=1), SPREAD)) or 1.0
    return Similarity(distance, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), middle)
