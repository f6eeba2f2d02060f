"""Shading of surface points: texture, shadows, highlights and one mirror reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32

from stages.tracing.light import Lighting
from stages.tracing.texture import TexturePyramid
from stages.tracing.tracer import Tracer
from stages.tracing.world import World

FAINTEST_REFLECTION = np.float32(0.03)
"""Subtracted from every reflectance; where nothing remains, no mirror ray is traced."""

STRONGEST_REFLECTION = np.float32(0.5)
REFLECTION_ANGLE = 0.01
"""Blur of mirror images, in radians: nothing here is polished glass."""


AWAY = 2e-3
"""Mirror rays start this far off the surface, in world units, so that they do not hit it again."""

LIFT = 0.02
"""Shadows are looked up this far off the surface, in world units, so that it does not shadow itself."""


@dataclass(frozen=True)
class Spots:
    """N surface points and the rays that see them.

    `normal` is the unit normal on the viewer's side, `u` and `v` are texture coordinates in pages, `direction` is the
    unit direction of the ray, and `width` is the ray's footprint across it, in world units. Where a ray hit nothing,
    `solid` is -1 and the other fields are meaningless.
    """

    point: Float32[np.ndarray, "3 n"]
    normal: Float32[np.ndarray, "3 n"]
    u: Float32[np.ndarray, " n"]
    v: Float32[np.ndarray, " n"]
    solid: Int32[np.ndarray, " n"]
    direction: Float32[np.ndarray, "3 n"]
    width: Float32[np.ndarray, " n"]

    def select(self, chosen: Bool[np.ndarray, " n"]) -> Spots:
        """The chosen spots, in order."""
        return Spots(*(part[..., chosen] for part in vars(self).values()))

    def joined(self, others: Spots) -> Spots:
        """These spots followed by `others`."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return Spots(*(np.concatenate(pair, axis=-1) for pair in pairs))


class Shader:
    """Shades spots of one world. `gloss` scales the gloss of all its materials."""

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
        self,
        point: Float32[np.ndarray, "3 n"],
        solid: Int32[np.ndarray, " n"],
        direction: Float32[np.ndarray, "3 n"],
        width: Float32[np.ndarray, " n"],
    ) -> Spots:
        """The spots at N points on the surfaces of N solids, seen along the unit vectors `direction`."""
        found = np.zeros((5, solid.size), np.float32)
        order = np.argsort(solid.astype(np.int16), kind="stable")
        numbers, starts = np.unique(solid[order], return_index=True)
        for number, chosen in zip(numbers, np.split(order, starts)[1:], strict=True):
            if number < 0:
                continue
            body = self._world.solids[number]
            x, y, z = (coordinate[chosen] for coordinate in point)
            local, u, v = body.shape.surface(body.frame.point_to_local((x, y, z)))
            for row, values in enumerate(body.frame.direction_to_world(local)):
                found[row, chosen] = values
            found[3, chosen] = u * np.float32(1 / body.material.extent) + np.float32(body.patch[0])
            found[4, chosen] = v * np.float32(1 / body.material.extent) + np.float32(body.patch[1])
        normal, (u, v) = found[:3], found[3:]
        away = (normal * direction).sum(axis=0) > 0
        normal = normal * np.where(away, np.float32(-1), np.float32(1))  # rooms are seen from the inside
        return Spots(point, normal, u, v, solid, direction, width)

    def radiance(self, spots: Spots, bounces: int = 1) -> Float32[np.ndarray, "3 n"]:
        """Linear radiance of N spots towards the viewer, 0 without a hit; `bounces=0` leaves out mirror images."""
        facing = np.maximum(-(spots.normal * spots.direction).sum(axis=0), np.float32(0.02))
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
        """Diffuse light on N spots, before albedo, and Blinn-Phong highlights of the suns, both [3, N]."""
        point, normal, direction = spots.point, spots.normal, spots.direction
        gloss = self._gloss[spots.solid]
        sky = self._world.sky
        above, below = _column(sky.above), _column(sky.below)
        diffuse = above * self._lighting.sky(
            (point[0], point[1], point[2]), (normal[0], normal[1], normal[2])
        ) + below * (1 - np.float32(0.5) * normal[2])
        highlight = np.zeros_like(diffuse)
        shiny = np.flatnonzero(gloss)
        lifted = spots.point + normal * np.float32(LIFT)
        for sun, shadow in self._lighting.suns:
            color, towards = _column(sun.color), _column(sun.towards)
            lit = np.maximum((normal * towards).sum(axis=0), 0) * shadow.lit((lifted[0], lifted[1], lifted[2]))
            diffuse += color * lit
            half = towards - direction[:, shiny]
            length = np.sqrt((half * half).sum(axis=0)) + np.float32(1e-6)
            match = np.maximum((normal[:, shiny] * half).sum(axis=0) / length, 0)
            highlight[:, shiny] += color * (match**40 * np.minimum(lit[shiny] * 4, 1) * gloss[shiny])
        for lamp in self._world.lamps:
            offset = _column(lamp.position) - spots.point
            square = (offset * offset).sum(axis=0) + np.float32(1e-6)
            slant = np.maximum((normal * offset).sum(axis=0), 0)
            fall = slant / (np.sqrt(square) * (1 + square * np.float32(1 / lamp.reach**2)))
            diffuse += _column(lamp.color) * fall
        return diffuse, highlight

    def _reflect(self, light: np.ndarray, spots: Spots, facing: np.ndarray) -> None:
        """Blend mirror images into `light`, in place, weighted by gloss times Schlick's approximation."""
        share = self._gloss[spots.solid] * (np.float32(0.05) + np.float32(0.95) * (1 - facing) ** 5)
        share -= FAINTEST_REFLECTION
        chosen = np.flatnonzero(share > 0)
        if not chosen.size:
            return
        chosen = chosen[np.argsort(spots.solid[chosen], kind="stable")]  # keeps bundles coherent
        normal, direction = spots.normal[:, chosen], spots.direction[:, chosen]
        mirrored = direction + 2 * facing[chosen] * normal
        start = spots.point[:, chosen] + normal * np.float32(AWAY)
        distance, solid = self.tracer.first((start[0], start[1], start[2]), (mirrored[0], mirrored[1], mirrored[2]))
        distance[solid < 0] = 0
        width = distance * np.float32(REFLECTION_ANGLE)
        seen = self.radiance(self.spots(start + distance * mirrored, solid, mirrored, width), bounces=0)
        part = np.minimum(share[chosen], STRONGEST_REFLECTION)
        light[:, chosen] = light[:, chosen] * (1 - part) + seen * part


def _column(vector: tuple[float, float, float]) -> Float32[np.ndarray, "3 1"]:
    return np.array(vector, np.float32)[:, None]
