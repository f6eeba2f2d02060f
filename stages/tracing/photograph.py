"""Pictures of a world: rays through the pixels, and one colour for all rays of a pixel that meet the same surface."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from stages.tracing.shading import Shader, Spots
from stages.tracing.shapes import Coordinates
from stages.tracing.world import World

TILE_RAYS = 147456
"""Rays traced together: enough to make each step worth its call, few enough for a core's own cache."""

FLAT = 0.25
"""A pixel is shaded once if all that its rays meet lies this close to one plane, in widths of the pixel there."""

SHARPNESS = 0.7
"""Paint is blurred over this part of a pixel; the slope of the surface blurs it further."""


class Studio:
    """A world with everything that all its pictures share. `gloss` scales the shine of everything in it."""

    def __init__(self, world: World, gloss: float = 1.0) -> None:
        self._shader = Shader(world, gloss)

    def photograph(
        self,
        world_to_camera: Float64[np.ndarray, "4 4"],
        intrinsics: Float64[np.ndarray, "3 3"],
        width: int,
        height: int,
        samples: int,
        generator: np.random.Generator,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """One picture, sRGB, the mean of `samples` rays a pixel, one in each of a square number of strata."""
        strata = round(samples**0.5)
        if strata * strata != samples:
            raise ValueError(f"samples must be a square number: {samples}")
        picture = np.empty((height, width, 3), np.uint8)
        for rows, columns in _tiles(width, height, samples):
            place = _sample_places(rows, columns, strata, generator)
            light = self._pixels(place, world_to_camera, intrinsics, samples)
            shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
            picture[rows, columns] = _develop(light).T.reshape(shape)
        return picture

    def depth(
        self,
        world_to_camera: Float64[np.ndarray, "4 4"],
        intrinsics: Float64[np.ndarray, "3 3"],
        place: Float32[np.ndarray, "2 n"],
    ) -> Float32[np.ndarray, " n"]:
        """Depth along the optical axis of what the picture shows at N places (x, y in pixels)."""
        direction = _directions(place, world_to_camera, intrinsics)
        distance, _ = self._shader.tracer.first(_origin(world_to_camera), direction)
        x, y, z = (float(part) for part in world_to_camera[2, :3])
        return distance * (direction[0] * x + direction[1] * y + direction[2] * z)

    def _pixels(
        self, place: np.ndarray, world_to_camera: np.ndarray, intrinsics: np.ndarray, samples: int
    ) -> Float32[np.ndarray, "3 pixels"]:
        """Linear light of pixels, of which each has `samples` consecutive places [2, pixels * samples]."""
        direction = _directions(place, world_to_camera, intrinsics)
        origin = _origin(world_to_camera)
        distance, solid = self._shader.tracer.first(origin, direction)
        distance[solid < 0] = 0
        x, y, z = (start + distance * step for start, step in zip(origin, direction, strict=True))
        point = np.stack([x, y, z])
        width = distance * np.float32(SHARPNESS / intrinsics[0, 0])

        smooth = (solid.reshape(-1, samples) == solid[::samples, None]).all(axis=1)
        candidates = np.flatnonzero(smooth)
        middle = point.reshape(3, -1, samples)[:, candidates].mean(axis=2)
        towards = _normalised(middle - np.stack(origin))
        first = candidates * samples
        spots = self._shader.spots(middle, solid[first], towards, width[first])
        flat = _height(point, spots, candidates, samples) <= spots.width * np.float32(FLAT / SHARPNESS)
        smooth[candidates[~flat]] = False

        rays = (np.flatnonzero(~smooth)[:, None] * samples + np.arange(samples)).reshape(-1)
        narrow = width[rays] * np.float32(samples**-0.5)
        rough = self._shader.spots(point[:, rays], solid[rays], np.stack(direction)[:, rays], narrow)
        seen = self._shader.radiance(spots.select(flat).joined(rough))
        light = np.empty((3, smooth.size), np.float32)
        light[:, smooth], single = np.split(seen, [np.count_nonzero(flat)], axis=1)
        light[:, ~smooth] = single.reshape(3, -1, samples).mean(axis=2)
        return light


def _height(
    point: Float32[np.ndarray, "3 rays"], spots: Spots, pixels: np.ndarray, samples: int
) -> Float32[np.ndarray, " n"]:
    """How far, at most, what a pixel's rays met lies off the plane through the pixel's spot."""
    off = np.zeros((pixels.size, samples), np.float32)
    for coordinate, centre, side in zip(point, spots.point, spots.normal, strict=True):
        off += (coordinate.reshape(-1, samples)[pixels] - centre[:, None]) * side[:, None]
    return np.abs(off).max(axis=1)


def _normalised(vector: Float32[np.ndarray, "3 n"]) -> Float32[np.ndarray, "3 n"]:
    x, y, z = vector
    return vector / np.sqrt(x * x + y * y + z * z + np.float32(1e-12))


def _tiles(width: int, height: int, samples: int) -> Iterator[tuple[slice, slice]]:
    side = max(int((TILE_RAYS / samples) ** 0.5), 1)
    for top in range(0, height, side):
        for left in range(0, width, side):
            yield slice(top, min(top + side, height)), slice(left, min(left + side, width))


def _sample_places(
    rows: slice, columns: slice, strata: int, generator: np.random.Generator
) -> Float32[np.ndarray, "2 n"]:
    """Where the samples of a tile's pixels lie, x and y in pixels: one at random in each stratum of each pixel."""
    shape = (rows.stop - rows.start, columns.stop - columns.start, strata, strata)
    jitter = generator.random((2, *shape), dtype=np.float32)
    inner = np.arange(strata, dtype=np.float32)
    x = np.arange(columns.start, columns.stop, dtype=np.float32)[None, :, None, None]
    y = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None, None, None]
    x = x + (inner[None, None, None, :] + jitter[0]) / np.float32(strata)
    y = y + (inner[None, None, :, None] + jitter[1]) / np.float32(strata)
    return np.stack([x.ravel(), y.ravel()])


def _origin(world_to_camera: np.ndarray) -> Coordinates:
    x, y, z = (np.full(1, part, np.float32) for part in -world_to_camera[:3, :3].T @ world_to_camera[:3, 3])
    return x, y, z


def _directions(place: np.ndarray, world_to_camera: np.ndarray, intrinsics: np.ndarray) -> Coordinates:
    """Unit vectors, in the world, through places in the picture."""
    x = (place[0] - np.float32(intrinsics[0, 2])) / np.float32(intrinsics[0, 0])
    y = (place[1] - np.float32(intrinsics[1, 2])) / np.float32(intrinsics[1, 1])
    right, down, forward = world_to_camera[:3, :3, None].astype(np.float32)
    a, b, c = _normalised(x * right + y * down + forward)
    return a, b, c


def _develop(light: Float32[np.ndarray, "3 pixels"]) -> UInt8[np.ndarray, "3 pixels"]:
    """Linear light to sRGB bytes, with a soft shoulder instead of burnt-out whites."""
    return ((1 - np.exp(-1.6 * light)) ** np.float32(1 / 2.2) * 255 + np.float32(0.5)).astype(np.uint8)
