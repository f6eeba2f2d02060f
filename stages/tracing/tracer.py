"""Finds the first solid that each ray hits."""

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
    """B cones around bundles of rays: origins within `spread` of `apex`, cosines to `axis` of at least `cosine`.

    Of rays with a single origin, all bundles share its `apex` and `spread`.
    """

    apex: Float64[np.ndarray, "1 3"] | Float64[np.ndarray, "B 3"]
    spread: Float64[np.ndarray, " 1"] | Float64[np.ndarray, " B"]
    axis: Float64[np.ndarray, "B 3"]
    cosine: Float64[np.ndarray, " B"]

    @staticmethod
    def around(
        origin: Float32[np.ndarray, "3 1 1"] | Float32[np.ndarray, "3 B rays"],
        direction: Float32[np.ndarray, "3 B rays"],
    ) -> Bundles:
        """The cones around B bundles of rays with unit directions."""
        low, high = origin.min(axis=2).astype(np.float64).T, origin.max(axis=2).astype(np.float64).T
        axis = direction.mean(axis=2, dtype=np.float64).T
        axis /= np.linalg.norm(axis, axis=1, keepdims=True) + 1e-12
        cosine = np.einsum("kbr,bk->br", direction, axis).min(axis=1)
        return Bundles((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2, axis, np.minimum(cosine, 1))

    def reach(self, centres: Float64[np.ndarray, "K 3"], radii: Float64[np.ndarray, " K"]) -> Bool[np.ndarray, "B K"]:
        """Whether any ray of each of B bundles may touch each of K spheres; there are no false negatives."""
        offset = centres[None] - self.apex[:, None]
        forward = (offset * self.axis[:, None]).sum(axis=2)
        across = np.sqrt(np.maximum((offset * offset).sum(axis=2) - forward * forward, 0))
        margin = radii[None] + self.spread[:, None] + 1e-3
        cosine = self.cosine[:, None]
        sine = np.sqrt(np.maximum(1 - cosine * cosine, 0)) + 1e-3
        return np.logical_or(cosine <= 0, (forward > -margin) & (across * cosine - forward * sine <= margin))


class Tracer:
    """Intersects rays with a scene's solids.

    A solid is tested only in bundles whose cone touches its bounding sphere, and there only for rays that pass through
    that sphere. The nearest spheres come first, so that solids behind a hit already found are skipped.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solids)
        self._centres = np.array([solid.frame.centre for solid in self.solids]).reshape(-1, 3)
        self._radii = np.array([solid.shape.bounding_radius for solid in self.solids])

    def first(
        self, origin: Coordinates, direction: Coordinates
    ) -> tuple[Float32[np.ndarray, " rays"], Int32[np.ndarray, " rays"]]:
        """Distance to the first surface along each ray, and the index of its solid; inf and -1 where there is none.

        Directions are unit vectors. A shared origin may be given as arrays of one element.
        """
        rays = direction[0].size
        starts, steps = _in_bundles(origin), _in_bundles(direction)
        distance = np.full(steps.shape[1:], np.inf, np.float32)
        winner = np.full(steps.shape[1:], -1, np.int32)
        bundles = Bundles.around(starts, steps)
        reached = bundles.reach(self._centres, self._radii)
        nearest = np.linalg.norm(self._centres - bundles.apex.mean(axis=0), axis=1) - self._radii
        order = np.argsort(nearest, kind="stable")
        for number in order[np.isin(order, np.flatnonzero(reached.any(axis=0)))]:
            rows = np.flatnonzero(reached[:, number])
            start, step = _rows(starts, rows), _rows(steps, rows)
            passing = np.flatnonzero(self._passes(number, start, step, distance[rows]))
            if passing.size:
                self._try(number, _rays(start, passing), _rays(step, passing), distance, winner, rows, passing)
        return distance.reshape(-1)[:rays], winner.reshape(-1)[:rays]

    def _try(
        self,
        number: int,
        start: Coordinates,
        step: Coordinates,
        distance: Float32[np.ndarray, "B rays"],
        winner: Int32[np.ndarray, "B rays"],
        rows: np.ndarray,
        passing: np.ndarray,
    ) -> None:
        """Intersect a solid with the `passing` rays of bundles `rows`; update `distance` and `winner` where nearer."""
        solid = self.solids[number]
        found = solid.shape.hit(solid.frame.point_to_local(start), solid.frame.direction_to_local(step))
        ray = (rows[:, None] * BUNDLE + np.arange(BUNDLE)).reshape(-1)[passing]
        nearer = found < distance.reshape(-1)[ray]
        ray = ray[nearer]
        distance.reshape(-1)[ray] = found[nearer]
        winner.reshape(-1)[ray] = number

    def _passes(
        self, number: int, origin: Coordinates, direction: Coordinates, limit: Float32[np.ndarray, "b rays"]
    ) -> Bool[np.ndarray, "b rays"]:
        """Which rays enter the bounding sphere of solid `number` at a distance below `limit`."""
        x, y, z = (float(middle) - start for middle, start in zip(self._centres[number], origin, strict=True))
        radius = float(self._radii[number]) + 1e-3
        forward = x * direction[0] + y * direction[1] + z * direction[2]
        square = x * x + y * y + z * z
        # Rounding errors are about 1e-7 of `square`: a slightly larger sphere makes sure that no ray is missed.
        across = square * np.float32(1 - 1e-5) - forward * forward
        return (across <= radius * radius) & (forward >= -radius) & (forward - radius < limit)


def _in_bundles(coordinates: Coordinates) -> Float32[np.ndarray, "3 B rays"]:
    """Rays in bundles of `BUNDLE`, the last ray repeated to fill its bundle; a single (shared) value as [3, 1, 1]."""
    stacked = np.stack(coordinates)
    if stacked.shape[1] == 1:
        return stacked[:, :, None]
    missing = -stacked.shape[1] % BUNDLE
    if missing:
        stacked = np.concatenate([stacked, np.repeat(stacked[:, -1:], missing, axis=1)], axis=1)
    return stacked.reshape(3, -1, BUNDLE)


def _rows(coordinates: np.ndarray, rows: np.ndarray) -> Coordinates:
    """Coordinates of the bundles `rows`; a shared value is returned unchanged."""
    x, y, z = coordinates if coordinates.shape[1] == 1 else (part[rows] for part in coordinates)
    return x, y, z


def _rays(coordinates: Coordinates, chosen: np.ndarray) -> Coordinates:
    """Coordinates of the `chosen` rays, flattened; a shared value is returned unchanged."""
    x, y, z = (part.reshape(-1) if part.size == 1 else part.reshape(-1)[chosen] for part in coordinates)
    return x, y, z
