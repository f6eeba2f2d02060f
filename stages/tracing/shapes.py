"""The solids that scenes are made of: ray intersection, normals and texture coordinates.

Coordinates are passed as three separate float32 arrays (x, y, z), because the arithmetic runs fastest that way. Shapes
work in their own frame, which is rotated and translated but not scaled against the world's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float32, Float64

Coordinates = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x, y and z of N points or directions: float32 arrays of one shape, or of one element for a shared value."""

NEAREST = 1e-3
"""A hit nearer than this, in world units, is on the surface that the ray has just left."""

TINY = np.float32(1e-12)
"""Added to a divisor that may be zero; negligible against any other."""


@dataclass(frozen=True)
class Frame:
    """A shape's pose: world = centre + axesᵀ local. The rows of `axes` are the orthonormal local axes in the world."""

    centre: Float64[np.ndarray, " 3"]
    axes: Float64[np.ndarray, "3 3"]

    def point_to_local(self, point: Coordinates) -> Coordinates:
        x, y, z = (coordinate - float(middle) for coordinate, middle in zip(point, self.centre, strict=True))
        return self.direction_to_local((x, y, z))

    def direction_to_local(self, direction: Coordinates) -> Coordinates:
        return _rotate(self.axes, direction)

    def direction_to_world(self, direction: Coordinates) -> Coordinates:
        return _rotate(self.axes.T, direction)


def _rotate(matrix: np.ndarray, vector: Coordinates) -> Coordinates:
    """matrix @ vector, skipping products with zero: most shapes are rotated about one axis only."""
    return _combine(matrix[0], vector), _combine(matrix[1], vector), _combine(matrix[2], vector)


def _combine(factors: np.ndarray, vector: Coordinates) -> np.ndarray:
    terms = [
        coordinate if factor == 1 else coordinate * float(factor)
        for factor, coordinate in zip(factors, vector, strict=True)
        if abs(factor) > 1e-9
    ]
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


class Shape(Protocol):
    """A solid in its own frame."""

    @property
    def bounding_radius(self) -> float:
        """Radius of a sphere about the frame's centre that encloses the solid."""

    def hit(self, origin: Coordinates, direction: Coordinates) -> Float32[np.ndarray, "*rays"]:
        """Distance, in units of `direction`'s length, to the first surface beyond `NEAREST`; infinite if there is none.

        From inside a solid this is its far wall, so a box can serve as a room.
        """

    def surface(self, point: Coordinates) -> tuple[Coordinates, np.ndarray, np.ndarray]:
        """Outward unit normal at `point`, which is on the surface, and texture coordinates u and v in world units."""


def _first_in_front(near: np.ndarray, far: np.ndarray, valid: np.ndarray) -> np.ndarray:
    distance = np.where(near > NEAREST, near, far)
    return np.where(valid & (distance > NEAREST), distance, np.float32(np.inf))


@dataclass(frozen=True)
class Box:
    """|x|, |y|, |z| ≤ `half`. Within `bevel` world units of an edge the normal bends, as if the edge were round."""

    half: tuple[float, float, float]
    bevel: float = 0.0

    @property
    def bounding_radius(self) -> float:
        return float(np.linalg.norm(self.half))

    def hit(self, origin: Coordinates, direction: Coordinates) -> Float32[np.ndarray, "*rays"]:
        near, far = np.full(1, -np.inf, np.float32), np.full(1, np.inf, np.float32)
        for start, step, half in zip(origin, direction, self.half, strict=True):
            inverse = 1 / (step + TINY)
            middle = start * inverse
            reach = np.abs(inverse) * half
            near = np.maximum(near, -middle - reach)
            far = np.minimum(far, reach - middle)
        return _first_in_front(near, far, near <= far)

    def surface(self, point: Coordinates) -> tuple[Coordinates, np.ndarray, np.ndarray]:
        x, y, z = point
        depth_x, depth_y, depth_z = (
            half - np.abs(coordinate) for coordinate, half in zip(point, self.half, strict=True)
        )
        on_x = (depth_x <= depth_y) & (depth_x <= depth_z)
        on_y = ~on_x & (depth_y <= depth_z)
        on_z = ~on_x & ~on_y
        if self.bevel:
            turn = [np.maximum(1 - depth / self.bevel, 0) for depth in (depth_x, depth_y, depth_z)]
        else:
            turn = [np.zeros_like(depth_x)] * 3
        normal = tuple(
            np.copysign(np.where(on_face, 1, amount), coordinate).astype(np.float32)
            for on_face, amount, coordinate in zip((on_x, on_y, on_z), turn, point, strict=True)
        )
        side = np.where(on_x, np.copysign(1, x), np.where(on_y, np.copysign(2, y), np.copysign(3, z)))
        u = np.where(on_x, y, x) + side.astype(np.float32) * np.float32(0.731)  # a different patch for each face
        v = np.where(on_z, y, z)
        return _normalise(normal[0], normal[1], normal[2]), u, v


@dataclass(frozen=True)
class Ellipsoid:
    """(x/a)² + (y/b)² + (z/c)² ≤ 1 with half axes `half` = (a, b, c)."""

    half: tuple[float, float, float]

    @property
    def bounding_radius(self) -> float:
        return max(self.half)

    def hit(self, origin: Coordinates, direction: Coordinates) -> Float32[np.ndarray, "*rays"]:
        start = [coordinate * (1 / half) for coordinate, half in zip(origin, self.half, strict=True)]
        step = [coordinate * (1 / half) for coordinate, half in zip(direction, self.half, strict=True)]
        square = step[0] * step[0] + step[1] * step[1] + step[2] * step[2]
        cross = start[0] * step[0] + start[1] * step[1] + start[2] * step[2]
        excess = start[0] * start[0] + start[1] * start[1] + start[2] * start[2] - 1
        discriminant = cross * cross - square * excess
        root = np.sqrt(np.maximum(discriminant, 0))
        inverse = 1 / square
        return _first_in_front((-cross - root) * inverse, (root - cross) * inverse, discriminant > 0)

    def surface(self, point: Coordinates) -> tuple[Coordinates, np.ndarray, np.ndarray]:
        x, y, z = (coordinate * (1 / half) for coordinate, half in zip(point, self.half, strict=True))
        a, b, c = self.half
        normal = _normalise(x * (1 / a), y * (1 / b), z * (1 / c))
        # Azimuthal equidistant map about the +z pole: no seam, and no pinch at the pole, which is seen from above.
        ring = np.sqrt(x * x + y * y)
        stretch = np.arctan2(ring, z) / (ring + np.float32(1e-6))
        return normal, x * stretch * a, y * stretch * b


@dataclass(frozen=True)
class Frustum:
    """|z| ≤ `half_height`, with radius `bottom` at -half_height and `top` at +half_height: a cylinder, cone or disc."""

    bottom: float
    top: float
    half_height: float

    @property
    def bounding_radius(self) -> float:
        return float(np.hypot(max(self.bottom, self.top), self.half_height))

    @property
    def _middle_radius(self) -> float:
        return (self.bottom + self.top) / 2

    @property
    def _slope(self) -> float:
        return (self.top - self.bottom) / (2 * self.half_height)

    def hit(self, origin: Coordinates, direction: Coordinates) -> Float32[np.ndarray, "*rays"]:
        (x, y, z), (dx, dy, dz) = origin, direction
        radius = self._middle_radius + self._slope * z
        growth = self._slope * dz
        square = dx * dx + dy * dy - growth * growth + TINY
        cross = x * dx + y * dy - growth * radius
        excess = x * x + y * y - radius * radius
        discriminant = cross * cross - square * excess
        # The form of each root that is free of cancellation: for rays along the slope of a cone `square` is nearly 0.
        larger = -cross - np.copysign(np.sqrt(np.maximum(discriminant, 0)), cross)
        nearest = np.full(discriminant.shape, np.inf, np.float32)
        for distance in (larger / square, excess / (larger + TINY)):
            height = z + distance * dz
            on_side = (np.abs(height) <= self.half_height) & (discriminant > 0) & (distance > NEAREST)
            nearest = np.where(on_side, np.minimum(nearest, distance), nearest)
        inverse_height = 1 / (dz + TINY)
        for end, end_radius in ((-self.half_height, self.bottom), (self.half_height, self.top)):
            if end_radius == 0:
                continue
            distance = (end - z) * inverse_height
            across_x, across_y = x + distance * dx, y + distance * dy
            on_cap = (across_x * across_x + across_y * across_y <= end_radius * end_radius) & (distance > NEAREST)
            nearest = np.where(on_cap, np.minimum(nearest, distance), nearest)
        return nearest

    def surface(self, point: Coordinates) -> tuple[Coordinates, np.ndarray, np.ndarray]:
        x, y, z = point
        ring = np.sqrt(x * x + y * y)
        off_side = np.abs(ring - (self._middle_radius + self._slope * z))
        on_cap = (self.half_height - np.abs(z)) < off_side
        outward = 1 / (ring + np.float32(1e-6))
        steep = np.float32(-self._slope)
        normal = _normalise(
            np.where(on_cap, 0, x * outward).astype(np.float32),
            np.where(on_cap, 0, y * outward).astype(np.float32),
            np.where(on_cap, np.copysign(1, z), steep).astype(np.float32),
        )
        around = np.arctan2(y, x) * np.float32(max(self.bottom, self.top))
        return normal, np.where(on_cap, x, around), np.where(on_cap, y + np.float32(0.377), z)


def _normalise(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Coordinates:
    inverse = 1 / np.sqrt(x * x + y * y + z * z + TINY)
    return x * inverse, y * inverse, z * inverse
