"""Pictures of a world: rays through the pixels, the light on what they meet, one bounce off what shines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from stages.tracing.light import Lighting
from stages.tracing.shapes import Coordinates
from stages.tracing.texture import TexturePyramid
from stages.tracing.tracer import Tracer
from stages.tracing.world import World

TILE_RAYS = 4096
"""Rays traced together: few enough that their numbers stay in a core's own cache."""

FAINTEST_REFLECTION = 0.015


class Studio:
    """A world with everything that all its pictures share: the shadows, the sky's light and the pages' pyramid."""

    def __init__(self, world: World, gloss: float = 1.0) -> None:
        self._world = world
        self._tracer = Tracer(world.solids)
        self._lighting = Lighting(Tracer([solid for solid in world.solids if solid.casts_shadow]), world.suns)
        self._pyramid = TexturePyramid(world.pages)
        solids = world.solids
        self._page = np.array([solid.material.page for solid in solids], np.int32)
        self._extent = np.array([solid.material.extent for solid in solids], np.float32)
        self._gloss = np.array([solid.material.gloss * gloss for solid in solids], np.float32)
        self._glow = np.array([solid.material.glow for solid in solids], np.float32)
        self._tint = np.array([solid.tint for solid in solids], np.float32).T.copy()

    def photograph(
        self,
        world_to_camera: Float64[np.ndarray, "4 4"],
        intrinsics: Float64[np.ndarray, "3 3"],
        width: int,
        height: int,
        samples: int,
        random: np.random.Generator,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """One picture, sRGB, the mean of `samples` rays a pixel, one in each of a square number of strata."""
        strata = round(samples**0.5)
        if strata * strata != samples:
            raise ValueError(f"samples must be a square number: {samples}")
        picture = np.empty((height, width, 3), np.uint8)
        origin = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
        footprint = 1 / (float(intrinsics[0, 0]) * strata)
        for rows, columns in _tiles(width, height, samples):
            shape = (rows.stop - rows.start, columns.stop - columns.start)
            place = _sample_places(rows, columns, strata, random)
            direction = _directions(place, world_to_camera, intrinsics)
            start = tuple(np.full(1, coordinate, np.float32) for coordinate in origin)
            light = self._trace((start[0], start[1], start[2]), direction, footprint, bounces=1)
            mean = light.reshape(3, *shape, samples).mean(axis=3)
            picture[rows, columns] = _develop(mean * np.float32(self._world.exposure)).transpose(1, 2, 0)
        return picture

    def depth(
        self, world_to_camera: Float64[np.ndarray, "4 4"], intrinsics: Float64[np.ndarray, "3 3"], place: np.ndarray
    ) -> Float32[np.ndarray, " n"]:
        """Depth along the optical axis of what N pixel places [2, N] (x, y in pixels) show."""
        direction = _directions(place.astype(np.float32), world_to_camera, intrinsics)
        origin = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
        start = tuple(np.full(1, coordinate, np.float32) for coordinate in origin)
        distance, _ = self._tracer.first((start[0], start[1], start[2]), direction)
        x, y, z = (float(part) for part in world_to_camera[2, :3])
        return distance * (direction[0] * x + direction[1] * y + direction[2] * z)

    def _trace(
        self, origin: Coordinates, direction: Coordinates, footprint: float, bounces: int
    ) -> Float32[np.ndarray, "3 n"]:
        """Linear light that comes back along N rays of unit length, each `footprint` wide at distance 1."""
        distance, winner = self._tracer.first(origin, direction)
        distance = np.where(winner < 0, 0, distance).astype(np.float32)
        x, y, z = (start + distance * step for start, step in zip(origin, direction, strict=True))
        point = (x, y, z)
        normal, u, v = self._surface(point, winner)
        towards = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
        flip = np.where(towards > 0, np.float32(-1), np.float32(1))  # walls and domes are seen from inside
        normal = (normal[0] * flip, normal[1] * flip, normal[2] * flip)
        facing = np.maximum(np.abs(towards), 0.02)
        per_page = 1 / self._extent[winner]
        texels = distance * footprint * per_page * self._pyramid.size / np.sqrt(facing)
        albedo = self._pyramid.lookup(self._page[winner], u * per_page, v * per_page, texels)
        albedo = albedo * self._tint[:, winner]
        light, highlight = self._light(point, normal, direction, self._gloss[winner])
        glow = self._glow[winner]
        light = albedo * (light * (1 - glow) + glow) + highlight
        if bounces:
            self._reflect(light, point, normal, direction, facing, winner, footprint)
        light[:, winner < 0] = 0
        return light

    def _surface(self, point: Coordinates, winner: np.ndarray) -> tuple[Coordinates, np.ndarray, np.ndarray]:
        """Normals in the world, and places on the pages in world units, of what the rays met."""
        found = np.zeros((5, winner.size), np.float32)
        for number in np.unique(winner):
            if number < 0:
                continue
            solid = self._world.solids[number]
            rays = np.flatnonzero(winner == number)
            x, y, z = point[0][rays], point[1][rays], point[2][rays]
            local, u, v = solid.shape.surface(solid.frame.point_to_local((x, y, z)))
            extent = solid.material.extent
            for row, values in enumerate(solid.frame.direction_to_world(local)):
                found[row, rays] = values
            found[3, rays] = u + solid.patch[0] * extent
            found[4, rays] = v + solid.patch[1] * extent
        return (found[0], found[1], found[2]), found[3], found[4]

    def _light(
        self, point: Coordinates, normal: Coordinates, direction: Coordinates, gloss: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Diffuse light on the surfaces, and the highlights (Blinn and Phong's) to add to what they send back."""
        sky = self._world.sky
        open_sky = self._lighting.sky(point, normal)
        above, below = np.array(sky.above, np.float32)[:, None], np.array(sky.below, np.float32)[:, None]
        diffuse = above * open_sky + below * (1 - np.float32(0.5) * normal[2])
        highlight = np.zeros((3, 1), np.float32)
        shiny = bool(gloss.any())
        lifted = tuple(coordinate + side * np.float32(0.02) for coordinate, side in zip(point, normal, strict=True))
        for sun, shadow in self._lighting.suns:
            x, y, z = sun.towards
            slant = np.maximum(normal[0] * x + normal[1] * y + normal[2] * z, 0)
            lit = slant * shadow.lit((lifted[0], lifted[1], lifted[2]))
            color = np.array(sun.color, np.float32)[:, None]
            diffuse = diffuse + color * lit
            if shiny:
                half = (x - direction[0], y - direction[1], z - direction[2])
                length = np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]) + np.float32(1e-6)
                match = np.maximum((normal[0] * half[0] + normal[1] * half[1] + normal[2] * half[2]) / length, 0)
                highlight = highlight + color * (match**40 * np.minimum(lit * 4, 1) * gloss)
        for lamp in self._world.lamps:
            offset = tuple(np.float32(a) - b for a, b in zip(lamp.position, point, strict=True))
            square = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
            slant = normal[0] * offset[0] + normal[1] * offset[1] + normal[2] * offset[2]
            fall = np.maximum(slant, 0) / np.sqrt(square + np.float32(1e-6)) / (1 + square / np.float32(lamp.reach**2))
            diffuse = diffuse + np.array(lamp.color, np.float32)[:, None] * fall
        return diffuse, highlight

    def _reflect(
        self,
        light: np.ndarray,
        point: Coordinates,
        normal: Coordinates,
        direction: Coordinates,
        facing: np.ndarray,
        winner: np.ndarray,
        footprint: float,
    ) -> None:
        """Add to `light` what glossy surfaces mirror, by Schlick's share of it."""
        share = self._gloss[winner] * (np.float32(0.05) + np.float32(0.95) * (1 - facing) ** 5)
        rays = np.flatnonzero(share > FAINTEST_REFLECTION)
        if not rays.size:
            return
        twice = 2 * (normal[0][rays] * direction[0][rays] + normal[1][rays] * direction[1][rays])
        twice = twice + 2 * normal[2][rays] * direction[2][rays]
        mirrored = tuple(step[rays] - twice * side[rays] for step, side in zip(direction, normal, strict=True))
        start = tuple(
            coordinate[rays] + side[rays] * np.float32(2e-3) for coordinate, side in zip(point, normal, strict=True)
        )
        seen = self._trace(
            (start[0], start[1], start[2]), (mirrored[0], mirrored[1], mirrored[2]), footprint * 6, bounces=0
        )
        part = np.minimum(share[rays], 0.5)
        light[:, rays] = light[:, rays] * (1 - part) + seen * part


def _tiles(width: int, height: int, samples: int) -> Iterator[tuple[slice, slice]]:
    side = max(int((TILE_RAYS / samples) ** 0.5), 1)
    for top in range(0, height, side):
        for left in range(0, width, side):
            yield slice(top, min(top + side, height)), slice(left, min(left + side, width))


def _sample_places(rows: slice, columns: slice, strata: int, random: np.random.Generator) -> Float32[np.ndarray, "2 n"]:
    """Where the samples of a tile's pixels lie, x and y in pixels: one at random in each stratum of each pixel."""
    shape = (rows.stop - rows.start, columns.stop - columns.start, strata, strata)
    jitter = random.random((2, *shape), dtype=np.float32)
    inner = np.arange(strata, dtype=np.float32)
    x = np.arange(columns.start, columns.stop, dtype=np.float32)[None, :, None, None]
    y = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None, None, None]
    x = x + (inner[None, None, None, :] + jitter[0]) / np.float32(strata)
    y = y + (inner[None, None, :, None] + jitter[1]) / np.float32(strata)
    return np.stack([x.ravel(), y.ravel()])


def _directions(place: np.ndarray, world_to_camera: np.ndarray, intrinsics: np.ndarray) -> Coordinates:
    """Unit vectors, in the world, through places in the picture."""
    x = (place[0] - np.float32(intrinsics[0, 2])) / np.float32(intrinsics[0, 0])
    y = (place[1] - np.float32(intrinsics[1, 2])) / np.float32(intrinsics[1, 1])
    inverse = 1 / np.sqrt(x * x + y * y + 1)
    right, down, forward = world_to_camera[:3, :3].astype(np.float32)
    direction = tuple((x * right[k] + y * down[k] + forward[k]) * inverse for k in range(3))
    return direction[0], direction[1], direction[2]


def _develop(light: np.ndarray) -> UInt8[np.ndarray, "3 h w"]:
    """Linear light to sRGB bytes, with a soft shoulder instead of burnt-out whites."""
    return ((1 - np.exp(-1.6 * light)) ** np.float32(1 / 2.2) * 255 + np.float32(0.5)).astype(np.uint8)
