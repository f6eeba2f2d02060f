"""Coordinate frames derived from the data alone: of a rig of cameras, and of splats without cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from stages.scene.alignment import Rig
from stages.scene.similarity import Similarity

SPREAD = 0.9
"""Fraction of splats' centres within a distance of 1 of the origin, in their own frame."""


def rig_frame(rig: Rig) -> Similarity:
    """From the coordinates of a rig to the world.

    The origin is the point that the cameras look at; x points right and y forward, as seen by the mean camera with a
    level horizon, and z up. The unit is the median distance of the cameras from the origin.
    """
    axes = np.stack([np.cross(rig.forward, rig.up), rig.forward, rig.up], axis=1)
    return Similarity(rig.distance, axes, rig.focus)


def splats_frame(means: Float[np.ndarray, "N 3"]) -> Similarity:
    """The corresponding frame for splats without cameras, assuming that y points down in their world, as in COLMAP's.

    The origin is the median of the centres, and 90 % of them lie within a distance of 1. Raises `ValueError` for N = 0.
    """
    if not len(means):
        raise ValueError("there are no splats to find the middle of")
    middle = np.median(means, axis=0).astype(np.float64)
    distance = float(np.quantile(np.linalg.norm(means - middle, axis=1), SPREAD)) or 1.0
    return Similarity(distance, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), middle)
