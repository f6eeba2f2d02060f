"""Regions of space: boxes and ellipsoids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from stages.scene.similarity import Similarity

Shape = Literal["box", "ellipsoid"]


@dataclass(frozen=True, eq=False)
class Region:
    """A box or an ellipsoid along the axes of a frame, in whose coordinates `centre` and the full `size` are given."""

    shape: Shape
    centre: Float[np.ndarray, " 3"]
    size: Float[np.ndarray, " 3"]
    frame: Similarity

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
        """Which points, in world coordinates, lie inside or on the surface. N = 0 is allowed."""
        local = np.abs(self.frame.inverse().points(points) - self.centre) / (self.size / 2)
        return (local <= 1).all(axis=1) if self.shape == "box" else (local**2).sum(axis=1) <= 1
