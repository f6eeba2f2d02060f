"""Which solid a ray meets first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from stages.tracing.shapes import Coordinates
from stages.tracing.world import Solid

BUNDLE = 64
"""Rays that are culled together. Neighbours in the arrays should be neighbours in space."""


@dataclass(frozen=True)
class Bundles:
    """B cones, each of which holds some rays: they start within `spread` of `apex` and lean off `axis` so far at most."""

    apex: Float64[np.ndarray, "B 3"]
    spread: Float64[np.ndarray, " B"]
    axis: Float64[np.ndarray, "B 3"]
    cosine: Float64[np.ndarray, " B"]

    @staticmethod
    def around(
        origin: Float32[np.ndarray, "3 B rays"] | Float32[np.ndarray, "3 1 1"],
        direction: Float32[np.ndarray, "3 B rays"],
    ) -> Bundles:
        """The cones of B groups of rays of unit length."""
        low, high = origin.min(axis=2).astype(np.float64).T, origin.max(axis=2).astype(np.float64).T
        axis = direction.mean(axis=2, dtype=np.float64).T
        axis /= np.linalg.norm(axis, axis=1, keepdims=True) + 1e-12
        cosine = np.einsum("kbr,bk->br", direction, axis).min(axis=1)
        return Bundles((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2, axis, np.minimum(cosine, 1))

    def reach(self, centres: Float64[np.ndarray, "K 3"], radii: Float64[np.ndarray, " K"]) -> Bool[np.ndarray, "B K"]:
        """Which of K spheres some ray of each bundle may touch: none that one does is left out."""
        offset = centres[None] - self.apex[:, None]
        forward = (offset * self.axis[:, None]).sum(axis=2)
        across = np.sqrt(np.maximum((offset * offset).sum(axis=2) - forward * forward, 0))
        margin = radii[None] + self.spread[:, None] + 1e-3
        cosine = self.cosine[:, None]
        sine = np.sqrt(np.maximum(1 - cosine * cosine, 0)) + 1e-3
        return (cosine <= 0) | ((forward > -margin) & (across * cosine - forward * sine <= margin))


class Tracer:
    """Finds the first solid along rays.

    A solid is tried only on the bundles of rays whose cone touches its bounding sphere, and there only on the rays that
    pass through that sphere, nearest sphere first, so that what lies behind a surface already found is left out.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solids)
        self._centres = np.array([solid.frame.centre for solid in self.solids]).reshape(-1, 3)
        self._radii = np.array([solid.shape.bounding_radius for solid in self.solids])

    def first(
        self, origin: Coordinates, direction: Coordinates
    ) -> tuple[Float32[np.ndarray, " rays"], Int32[np.ndarray, " rays"]]:
        """Distance to the first surface along each ray of unit length, and the number of its solid.

        Rays that share their origin may give it as arrays of one element. Infinite, and -1, where a ray meets nothing.
        """
        rays = direction[0].size
        distance = np.full(-(-rays // BUNDLE) * BUNDLE, np.inf, np.float32)
        winner = np.full(distance.size, -1, np.int32)
        starts, steps = _in_bundles(origin), _in_bundles(direction)
        bundles = Bundles.around(starts, steps)
        reached = bundles.reach(self._centres, self._radii)
        starts, steps = starts.reshape(3, -1), steps.reshape(3, -1)
        nearest = np.linalg.norm(self._centres - bundles.apex.mean(axis=0), axis=1) - self._radii
        order = np.argsort(nearest, kind="stable")
        for number in order[reached.any(axis=0)[order]]:
            tried = _rays_of(np.flatnonzero(reached[:, number]))
            tried = tried[self._passes(number, _take(starts, tried), _take(steps, tried), distance[tried])]
            if not tried.size:
                continue
            solid = self.solids[number]
            start = solid.frame.point_to_local(_take(starts, tried))
            found = solid.shape.hit(start, solid.frame.direction_to_local(_take(steps, tried)))
            nearer = found < distance[tried]
            tried = tried[nearer]
            distance[tried] = found[nearer]
            winner[tried] = number
        return distance[:rays], winner[:rays]

    def _passes(
        self, number: int, origin: Coordinates, direction: Coordinates, limit: Float32[np.ndarray, " rays"]
    ) -> Bool[np.ndarray, " rays"]:
        """Which rays pass through a solid's bounding sphere before `limit`."""
        x, y, z = (float(middle) - start for middle, start in zip(self._centres[number], origin, strict=True))
        radius = float(self._radii[number]) + 1e-3
        forward = x * direction[0] + y * direction[1] + z * direction[2]
        square = x * x + y * y + z * z
        # Rounding errs by some 1e-7 of `square`: the sphere is a little larger, so that no ray is lost.
        across = square * np.float32(1 - 1e-5) - forward * forward
        return (across <= radius * radius) & (forward >= -radius) & (forward - radius < limit)


def _in_bundles(coordinates: Coordinates) -> Float32[np.ndarray, "3 B rays"]:
    """Rays in rows of `BUNDLE`, the last one repeated to fill its row; a shared value as [3, 1, 1]."""
    stacked = np.stack(coordinates)
    if stacked.shape[1] == 1:
        return stacked[:, :, None]
    missing = -stacked.shape[1] % BUNDLE
    if missing:
        stacked = np.concatenate([stacked, np.repeat(stacked[:, -1:], missing, axis=1)], axis=1)
    return stacked.reshape(3, -1, BUNDLE)


def _rays_of(bundles: np.ndarray) -> np.ndarray:
    return (bundles[:, None] * BUNDLE + np.arange(BUNDLE)).reshape(-1)


def _take(coordinates: np.ndarray, chosen: np.ndarray) -> Coordinates:
    """The coordinates of the chosen rays; shared ones as they are."""
    x, y, z = coordinates if coordinates.shape[1] == 1 else (row[chosen] for row in coordinates)
    return x, y, z
