"""Rendering of a world: several rays per pixel, shaded once where all of them hit the same flat surface."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from stages.tracing.shading import Shader, Spots
from stages.tracing.shapes import Coordinates
from stages.tracing.world import World

TILE_RAYS = 147456
"""Rays traced at a time: enough to amortise NumPy's call overhead, few enough for a core's cache."""

FLAT = 0.25
"""A pixel is shaded once if its hits are on one solid and within this many pixel widths of its tangent plane."""

SHARPNESS = 0.7
"""Width of the texture filter, in pixels; surfaces seen at a slant are filtered more."""


class Studio:
    """A world prepared for rendering, shared by all its pictures. `gloss` scales the gloss of all its materials."""

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
        """Render one sRGB picture with `samples` stratified rays per pixel.

        The camera is x right, y down, z forward. Raises `ValueError` if `samples` is not a square number.
        """
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
        """Depth along the optical axis at N image points (x, y in pixels); infinite where nothing is hit."""
        direction = _directions(place, world_to_camera, intrinsics)
        distance, _ = self._shader.tracer.first(_origin(world_to_camera), direction)
        x, y, z = (float(part) for part in world_to_camera[2, :3])
        return distance * (direction[0] * x + direction[1] * y + direction[2] * z)

    def _pixels(
        self, place: np.ndarray, world_to_camera: np.ndarray, intrinsics: np.ndarray, samples: int
    ) -> Float32[np.ndarray, "3 pixels"]:
        """Linear radiance of pixels; `place` [2, pixels * samples] lists the image points of each in turn."""
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
    """The largest distance of a pixel's hit points from the tangent plane of its spot, for N pixels."""
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
    """Image points (x, y in pixels) of a tile's samples: one random point in each stratum of each pixel."""
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
    """Unit ray directions, in world coordinates, through image points (x, y in pixels)."""
    x = (place[0] - np.float32(intrinsics[0, 2])) / np.float32(intrinsics[0, 0])
    y = (place[1] - np.float32(intrinsics[1, 2])) / np.float32(intrinsics[1, 1])
    right, down, forward = world_to_camera[:3, :3, None].astype(np.float32)
    a, b, c = _normalised(x * right + y * down + forward)
    return a, b, c


def _develop(light: Float32[np.ndarray, "3 pixels"]) -> UInt8[np.ndarray, "3 pixels"]:
    """Tone-map linear light to sRGB bytes (gamma 2.2), with a soft shoulder instead of clipped highlights."""
    return ((1 - np.exp(-1.6 * light)) ** np.float32(1 / 2.2) * 255 + np.float32(0.5)).astype(np.uint8)
