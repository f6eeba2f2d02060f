"""Shadow maps of the suns, and ambient occlusion of the sky.

Both are computed once per scene by tracing rays from the light, so that they are consistent in all its pictures, as in
photos of a real place.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from stages.tracing.shapes import Coordinates
from stages.tracing.tracer import Tracer
from stages.tracing.world import Sun, along

REACH = 6.5
"""Half the side of a shadow map and of the sky grid, in world units."""

MIDDLE = (0.0, 0.0, 1.5)

SHADOW_RESOLUTION = 1024
SHADOW_BIAS = 0.025
TILE = 256

SKY_DIRECTIONS = 28
SKY_RESOLUTION = 256
SKY_STEP = 0.125
"""Spacing of the sky grid, in world units."""


class ShadowMap:
    """Orthographic shadow map: the height, towards the light, of the first surface that it meets; -inf if none."""

    def __init__(self, casters: Tracer, towards: tuple[float, float, float], resolution: int) -> None:
        self._axes = along(towards)
        self._resolution = resolution
        self._texels_a_unit = resolution / (2 * REACH)
        grid = (np.arange(resolution, dtype=np.float32) + np.float32(0.5)) / np.float32(self._texels_a_unit) - REACH
        heights = np.empty((resolution, resolution), np.float32)
        for top in range(0, resolution, TILE):
            for left in range(0, resolution, TILE):
                across, down = np.meshgrid(grid[left : left + TILE], grid[top : top + TILE])
                heights[top : top + TILE, left : left + TILE] = self._heights(casters, across.ravel(), down.ravel())
        self._flat_heights = heights.reshape(-1)

    def _heights(self, casters: Tracer, across: np.ndarray, down: np.ndarray) -> np.ndarray:
        right, forward, towards = self._axes.astype(np.float32)
        origin = tuple(
            np.float32(middle) + across * right[k] + down * forward[k] + np.float32(2 * REACH) * towards[k]
            for k, middle in enumerate(MIDDLE)
        )
        direction = tuple(np.full_like(across, -towards[k]) for k in range(3))
        distance, _ = casters.first((origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2]))
        return (2 * REACH - distance).reshape(TILE, TILE)

    def lit(self, point: Coordinates) -> Float32[np.ndarray, " n"]:
        """Fraction of the light that reaches N points, in [0, 1]: percentage-closer filtering over four texels."""
        column, row, height = self._project(point)
        column, row = column - np.float32(0.5), row - np.float32(0.5)
        left, top = np.floor(column), np.floor(row)
        right_share, down_share = column - left, row - top
        last = self._resolution - 1
        left = np.clip(left.astype(np.int32), 0, last - 1)
        top = np.clip(top.astype(np.int32), 0, last - 1)
        start = top * self._resolution + left
        height = height + np.float32(SHADOW_BIAS)
        upper = self._open(start, height) * (1 - right_share) + self._open(start + 1, height) * right_share
        start = start + self._resolution
        lower = self._open(start, height) * (1 - right_share) + self._open(start + 1, height) * right_share
        return np.clip(upper + (lower - upper) * down_share, 0, 1)

    def lit_at_nearest(self, point: Coordinates) -> Float32[np.ndarray, " n"]:
        """1 for points that the light reaches, otherwise 0, by the nearest texel alone."""
        column, row, height = self._project(point)
        last = self._resolution - 1
        column, row = (np.clip(place.astype(np.int32), 0, last) for place in (column, row))
        return self._open(row * self._resolution + column, height + np.float32(2 * SHADOW_BIAS))

    def _open(self, texel: np.ndarray, height: np.ndarray) -> np.ndarray:
        return (self._flat_heights[texel] <= height).astype(np.float32)

    def _project(self, point: Coordinates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y, z = (coordinate - np.float32(middle) for coordinate, middle in zip(point, MIDDLE, strict=True))
        right, down, towards = (x * float(a[0]) + y * float(a[1]) + z * float(a[2]) for a in self._axes)
        texels = np.float32(self._texels_a_unit)
        return (right + REACH) * texels, (down + REACH) * texels, towards


class SkyLight:
    """Ambient light with occlusion, precomputed on a coarse grid.

    Each grid corner holds four numbers, a and b [3]: its visible sky lights a surface of normal n with a + b · n.
    """

    def __init__(self, casters: Tracer) -> None:
        self._shape = (round(2 * REACH / SKY_STEP) + 1, round(2 * REACH / SKY_STEP) + 1, round(5.0 / SKY_STEP) + 1)
        axes = [np.arange(count, dtype=np.float32) * np.float32(SKY_STEP) for count in self._shape]
        x, y, z = np.meshgrid(axes[0] - REACH, axes[1] - REACH, axes[2], indexing="ij")
        point = (x.ravel(), y.ravel(), z.ravel())
        total = np.zeros((4, point[0].size), np.float32)
        weights = 0.0
        for towards in _sky_directions():
            lit = ShadowMap(casters, towards, SKY_RESOLUTION).lit_at_nearest(point)
            total[0] += lit
            for axis in range(3):
                total[axis + 1] += lit * np.float32(towards[axis])
            weights += 1 + towards[2]
        # Normalised: an upward surface under an open sky has light 1.
        self._grid = np.ascontiguousarray((total / np.float32(weights)).T)

    def __call__(self, point: Coordinates, normal: Coordinates) -> Float32[np.ndarray, " n"]:
        """Sky light on surfaces at N points, interpolated trilinearly; 1 for an upward surface in the open."""
        lift = np.float32(0.6 * SKY_STEP)
        start = (point[0] + normal[0] * lift + REACH, point[1] + normal[1] * lift + REACH, point[2] + normal[2] * lift)
        cells, shares = [], []
        for coordinate, count in zip(start, self._shape, strict=True):
            place = np.clip(coordinate * np.float32(1 / SKY_STEP), 0, count - 1.001)
            cell = place.astype(np.int32)
            cells.append(cell)
            shares.append(place - cell)
        corner = (cells[0] * self._shape[1] + cells[1]) * self._shape[2] + cells[2]
        light = np.zeros((point[0].size, 4), np.float32)
        for right in (0, 1):
            for down in (0, 1):
                side = (shares[0] if right else 1 - shares[0]) * (shares[1] if down else 1 - shares[1])
                step = (right * self._shape[1] + down) * self._shape[2]
                light += self._grid[corner + step] * (side * (1 - shares[2]))[:, None]
                light += self._grid[corner + step + 1] * (side * shares[2])[:, None]
        towards = light[:, 1] * normal[0] + light[:, 2] * normal[1] + light[:, 3] * normal[2]
        return np.maximum(light[:, 0] + towards, 0)


def _sky_directions() -> list[tuple[float, float, float]]:
    """Unit vectors evenly spaced on the upper hemisphere (a Fibonacci spiral), with z between 0.08 and 0.98."""
    directions = []
    for number in range(SKY_DIRECTIONS):
        height = 0.08 + 0.9 * (number + 0.5) / SKY_DIRECTIONS
        angle = number * np.pi * (3 - np.sqrt(5))
        ring = np.sqrt(1 - height * height)
        directions.append((float(ring * np.cos(angle)), float(ring * np.sin(angle)), float(height)))
    return directions


class Lighting:
    """The precomputed light of a scene: one shadow map per sun, and the sky."""

    def __init__(self, casters: Tracer, suns: tuple[Sun, ...]) -> None:
        self.suns = tuple((sun, ShadowMap(casters, sun.towards, SHADOW_RESOLUTION)) for sun in suns)
        self.sky = SkyLight(casters)
