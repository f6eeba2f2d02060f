"""Which solid a ray meets first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from stages.tracing.shapes import Coordinates
from stages.tracing.world import Solid


@dataclass(frozen=True)
class Bundle:
    """A cone that holds a group of rays: they start within `spread` of `apex` and lean off `axis` by an angle at most."""

    apex: np.ndarray
    spread: float
    axis: np.ndarray
    cosine: float

    @staticmethod
    def around(origin: Coordinates, direction: Coordinates) -> Bundle:
        """The bundle of N > 0 rays of unit length; origins may be scalars."""
        low = np.array([coordinate.min() for coordinate in origin], np.float64)
        high = np.array([coordinate.max() for coordinate in origin], np.float64)
        axis = np.array([coordinate.mean(dtype=np.float64) for coordinate in direction])
        axis /= np.linalg.norm(axis) + 1e-12
        x, y, z = (float(part) for part in axis)
        cosine = float((direction[0] * x + direction[1] * y + direction[2] * z).min())
        return Bundle((low + high) / 2, float(np.linalg.norm(high - low)) / 2, axis, min(cosine, 1.0))

    def reaches(self, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """Which of K spheres some ray may touch: none that one does is left out."""
        offset = centres - self.apex
        forward = offset @ self.axis
        across = np.sqrt(np.maximum((offset * offset).sum(axis=1) - forward * forward, 0))
        margin = radii + self.spread + 1e-4
        if self.cosine <= 0:
            return np.ones(len(centres), bool)
        sine = np.sqrt(max(1 - self.cosine**2, 0.0)) + 1e-4
        return (forward > -margin) & (across * self.cosine - forward * sine <= margin)


class Tracer:
    """Finds the first solid along rays. Solids are tried only where their bounding sphere touches the bundle of rays."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solids)
        self._centres = np.array([solid.frame.centre for solid in self.solids]).reshape(-1, 3)
        self._radii = np.array([solid.shape.bounding_radius for solid in self.solids])

    def first(
        self, origin: Coordinates, direction: Coordinates
    ) -> tuple[Float32[np.ndarray, " rays"], Int32[np.ndarray, " rays"]]:
        """Distance to the first surface along each ray of unit length, and the number of its solid.

        Infinite, and -1, where a ray meets nothing.
        """
        distance = np.full(direction[0].shape, np.inf, np.float32)
        winner = np.full(direction[0].shape, -1, np.int32)
        reached = Bundle.around(origin, direction).reaches(self._centres, self._radii)
        for number in np.flatnonzero(reached):
            solid = self.solids[number]
            found = solid.shape.hit(solid.frame.point_to_local(origin), solid.frame.direction_to_local(direction))
            nearer = found < distance
            if nearer.any():
                distance = np.where(nearer, found, distance)
                winner[nearer] = number
        return distance, winner
