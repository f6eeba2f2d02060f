"""The light that comes back from places on the surfaces: paint, shadows, highlights and one mirror image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from stages.tracing.light import Lighting
from stages.tracing.shapes import Coordinates
from stages.tracing.texture import TexturePyramid
from stages.tracing.tracer import Tracer
from stages.tracing.world import World

FAINTEST_REFLECTION = 0.015
REFLECTION_ANGLE = 0.01
"""Mirror images are blurred over so many radians: nothing here is polished glass."""


LIFT = 0.02
"""Shadows are asked for this far off the surface, in world units, lest it shadows itself."""


@dataclass(frozen=True)
class Spots:
    """N places on surfaces and how they are looked at.

    `normal` is a unit vector on the side of the viewer, `u` and `v` the place on the page in pages, `direction` that of
    the ray, of unit length, and `width` what the ray covers there, in world units across it. `solid` is -1, and all
    else without meaning, where a ray met nothing.
    """

    point: Coordinates
    normal: Coordinates
    u: Float32[np.ndarray, " n"]
    v: Float32[np.ndarray, " n"]
    solid: Int32[np.ndarray, " n"]
    direction: Coordinates
    width: Float32[np.ndarray, " n"]


class Shader:
    """Shades spots of one world. `gloss` scales the shine of everything in it."""

    def __init__(self, world: World, gloss: float) -> None:
        self.tracer = Tracer(world.solids)
        self._world = world
        self._lighting = Lighting(Tracer([solid for solid in world.solids if solid.casts_shadow]), world.suns)
        self._pyramid = TexturePyramid(world.pages)
        materials = [solid.material for solid in world.solids]
        self._page = np.array([material.page for material in materials], np.int32)
        self._extent = np.array([material.extent for material in materials], np.float32)
        self._gloss = np.array([material.gloss * gloss for material in materials], np.float32)
        self._glow = np.array([material.glow for material in materials], np.float32)
        self._tint = np.array([solid.tint for solid in world.solids], np.float32).T.copy()

    def spots(
        self, point: Coordinates, solid: np.ndarray, direction: Coordinates, width: Float32[np.ndarray, " n"]
    ) -> Spots:
        """What N points on the surfaces of N solids are like, seen along `direction`."""
        found = np.zeros((5, solid.size), np.float32)
        order = np.argsort(solid.astype(np.int16), kind="stable")
        numbers, starts = np.unique(solid[order], return_index=True)
        for number, chosen in zip(numbers, np.split(order, starts[1:]), strict=True):
            if number < 0:
                continue
            body = self._world.solids[number]
            x, y, z = (coordinate[chosen] for coordinate in point)
            local, u, v = body.shape.surface(body.frame.point_to_local((x, y, z)))
            for row, values in enumerate(body.frame.direction_to_world(local)):
                found[row, chosen] = values
            found[3, chosen] = u * np.float32(1 / body.material.extent) + np.float32(body.patch[0])
            found[4, chosen] = v * np.float32(1 / body.material.extent) + np.float32(body.patch[1])
        towards = found[0] * direction[0] + found[1] * direction[1] + found[2] * direction[2]
        x, y, z = found[:3] * np.where(towards > 0, np.float32(-1), np.float32(1))  # rooms are seen from inside
        return Spots(point, (x, y, z), found[3], found[4], solid, direction, width)

    def radiance(self, spots: Spots, bounces: int = 1) -> Float32[np.ndarray, "3 n"]:
        """Linear light that leaves N spots towards the viewer."""
        facing = -sum(side * step for side, step in zip(spots.normal, spots.direction, strict=True))
        facing = np.maximum(facing, np.float32(0.02))
        texels = spots.width * np.float32(self._pyramid.size) / (self._extent[spots.solid] * np.sqrt(facing))
        albedo = self._pyramid.lookup(self._page[spots.solid], spots.u, spots.v, texels) * self._tint[:, spots.solid]
        light, highlight = self._light(spots)
        glow = self._glow[spots.solid]
        light = albedo * (light * (1 - glow) + glow) + highlight
        if bounces:
            self._reflect(light, spots, facing)
        light[:, spots.solid < 0] = 0
        return light

    def _light(self, spots: Spots) -> tuple[np.ndarray, np.ndarray]:
        """Diffuse light on the surfaces, and the highlights (Blinn and Phong's) to add to what they send back."""
        normal, direction, gloss = spots.normal, spots.direction, self._gloss[spots.solid]
        sky = self._world.sky
        above, below = np.float32(sky.above)[:, None], np.float32(sky.below)[:, None]
        diffuse = above * self._lighting.sky(spots.point, normal) + below * (1 - np.float32(0.5) * normal[2])
        highlight = np.zeros_like(diffuse)
        shiny = np.flatnonzero(gloss)
        x, y, z = (place + side * np.float32(LIFT) for place, side in zip(spots.point, normal, strict=True))
        for sun, shadow in self._lighting.suns:
            color = np.float32(sun.color)[:, None]
            lit = np.maximum(sum(side * part for side, part in zip(normal, sun.towards, strict=True)), 0)
            lit = lit * shadow.lit((x, y, z))
            diffuse += color * lit
            half = [part - step[shiny] for part, step in zip(sun.towards, direction, strict=True)]
            length = np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]) + np.float32(1e-6)
            match = np.maximum(sum(side[shiny] * part for side, part in zip(normal, half, strict=True)) / length, 0)
            highlight[:, shiny] += color * (match**40 * np.minimum(lit[shiny] * 4, 1) * gloss[shiny])
        for lamp in self._world.lamps:
            offset = [np.float32(a) - b for a, b in zip(lamp.position, spots.point, strict=True)]
            square = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2] + np.float32(1e-6)
            slant = np.maximum(sum(side * part for side, part in zip(normal, offset, strict=True)), 0)
            fall = slant / (np.sqrt(square) * (1 + square * np.float32(1 / lamp.reach**2)))
            diffuse += np.float32(lamp.color)[:, None] * fall
        return diffuse, highlight

    def _reflect(self, light: np.ndarray, spots: Spots, facing: np.ndarray) -> None:
        """Add to `light` what glossy surfaces mirror, by Schlick's share of it."""
        share = self._gloss[spots.solid] * (np.float32(0.05) + np.float32(0.95) * (1 - facing) ** 5)
        chosen = np.flatnonzero(share > FAINTEST_REFLECTION)
        if not chosen.size:
            return
        chosen = chosen[np.argsort(spots.solid[chosen], kind="stable")]  # rays off one surface travel together
        twice = 2 * facing[chosen]
        a, b, c = (
            step[chosen] + twice * side[chosen] for step, side in zip(spots.direction, spots.normal, strict=True)
        )
        x, y, z = (
            place[chosen] + side[chosen] * np.float32(2e-3)
            for place, side in zip(spots.point, spots.normal, strict=True)
        )
        distance, solid = self.tracer.first((x, y, z), (a, b, c))
        distance[solid < 0] = 0
        point = (x + distance * a, y + distance * b, z + distance * c)
        seen = self.radiance(self.spots(point, solid, (a, b, c), distance * np.float32(REFLECTION_ANGLE)), bounces=0)
        part = np.minimum(share[chosen], 0.5)
        light[:, chosen] = light[:, chosen] * (1 - part) + seen * part
