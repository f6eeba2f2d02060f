"""The parts of a scene (textured solids, lights and a sky), and the builder that assembles them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64

from stages.tracing.patterns import Page, soften
from stages.tracing.shapes import Box, Ellipsoid, Frame, Frustum, Shape

PAGE_SIZE = 1024
"""Side of every texture page, in texels."""

FINE = 0.3
FINE_CONTRAST = 0.5
"""Texture detail finer than `FINE` world units has its contrast reduced to this share, as in most real places.

In pictures 192 pixels wide the finest detail is only a pixel or two across, which splats are slow to learn.
"""

Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Material:
    """A texture page that repeats every `extent` world units, and how the surface responds to light.

    `gloss` in [0, 1] scales highlights and mirror images. `glow` in [0, 1] blends from a surface that is lit (0) to one
    that emits its own colour (1).
    """

    page: int
    extent: float
    gloss: float = 0.0
    glow: float = 0.0


@dataclass(frozen=True)
class Solid:
    """A shape with a pose and a material: `tint` multiplies the page, `patch` is its (u, v) offset on it, in pages."""

    shape: Shape
    frame: Frame
    material: Material
    tint: tuple[float, float, float]
    patch: tuple[float, float]
    casts_shadow: bool


@dataclass(frozen=True)
class Sun:
    """Directional light of a linear colour that casts shadows; `towards` is the unit vector from the scene to it."""

    towards: tuple[float, float, float]
    color: tuple[float, float, float]


@dataclass(frozen=True)
class Lamp:
    """Point light of a linear colour without shadows; its intensity is halved at the distance `reach`."""

    position: tuple[float, float, float]
    color: tuple[float, float, float]
    reach: float


@dataclass(frozen=True)
class Sky:
    """Ambient light: one linear colour from above and one from below."""

    above: tuple[float, float, float]
    below: tuple[float, float, float]


@dataclass(frozen=True)
class World:
    """A scene ready to be rendered: z is up, the floor is at z = 0, and the cameras circle the z axis."""

    solids: tuple[Solid, ...]
    pages: tuple[Page, ...]
    suns: tuple[Sun, ...]
    lamps: tuple[Lamp, ...]
    sky: Sky


def turned(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Float64[np.ndarray, "3 3"]:
    """Local axes, as rows, rotated by `roll` about x, then `pitch` about y, then `yaw` about z, in degrees."""
    (cos_z, cos_y, cos_x), (sin_z, sin_y, sin_x) = (f(np.radians([yaw, pitch, roll])) for f in (np.cos, np.sin))
    about_z = np.array([[cos_z, -sin_z, 0], [sin_z, cos_z, 0], [0, 0, 1]])
    about_y = np.array([[cos_y, 0, sin_y], [0, 1, 0], [-sin_y, 0, cos_y]])
    about_x = np.array([[1, 0, 0], [0, cos_x, -sin_x], [0, sin_x, cos_x]])
    return (about_z @ about_y @ about_x).T


def along(direction: Vector) -> Float64[np.ndarray, "3 3"]:
    """Orthonormal local axes, as rows, with z along `direction`; x and y are arbitrary."""
    up = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    helper = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.8 else np.array([0.0, 1.0, 0.0])
    right = np.cross(helper, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(up, right), up])


@dataclass
class Builder:
    """Collects pages, solids and lights. `generator` draws what the scene does not specify, such as patches."""

    generator: np.random.Generator
    pages: list[Page] = field(default_factory=list)
    solids: list[Solid] = field(default_factory=list)
    suns: list[Sun] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)

    def material(self, picture: Page, extent: float, gloss: float = 0.0, glow: float = 0.0) -> Material:
        """Add a page, its fine contrast reduced by `FINE_CONTRAST`, and return a material made of it."""
        block = 1 << round(np.log2(min(max(FINE / extent * len(picture), 1), len(picture) / 4)))
        self.pages.append(soften(picture, block, FINE_CONTRAST))
        return Material(len(self.pages) - 1, extent, gloss, glow)

    def box(
        self,
        centre: Vector,
        half: Vector,
        material: Material,
        *,
        axes: Float64[np.ndarray, "3 3"] | None = None,
        bevel: float = 0.0,
        tint: Vector = (1, 1, 1),
        patch: Vector | None = None,
        casts_shadow: bool = True,
    ) -> None:
        shape = Box((float(half[0]), float(half[1]), float(half[2])), bevel)
        self._add(shape, centre, np.eye(3) if axes is None else axes, material, tint, patch, casts_shadow)

    def ball(
        self,
        centre: Vector,
        half: Vector | float,
        material: Material,
        *,
        axes: Float64[np.ndarray, "3 3"] | None = None,
        tint: Vector = (1, 1, 1),
        patch: Vector | None = None,
        casts_shadow: bool = True,
    ) -> None:
        a, b, c = (half, half, half) if isinstance(half, int | float) else half
        shape = Ellipsoid((float(a), float(b), float(c)))
        self._add(shape, centre, np.eye(3) if axes is None else axes, material, tint, patch, casts_shadow)

    def rod(
        self,
        start: Vector,
        stop: Vector,
        radius: float,
        material: Material,
        *,
        end_radius: float | None = None,
        tint: Vector = (1, 1, 1),
        casts_shadow: bool = True,
    ) -> None:
        """Add a cylinder between two points, or a cone of `radius` at the start and `end_radius` at the end."""
        begin, end = np.asarray(start, np.float64), np.asarray(stop, np.float64)
        top = radius if end_radius is None else end_radius
        shape = Frustum(float(radius), float(top), float(np.linalg.norm(end - begin)) / 2)
        self._add(shape, (begin + end) / 2, along(end - begin), material, tint, None, casts_shadow)

    def _add(
        self,
        shape: Shape,
        centre: Vector | np.ndarray,
        axes: np.ndarray,
        material: Material,
        tint: Vector,
        patch: Vector | None,
        casts_shadow: bool,
    ) -> None:
        start = self.generator.random(2) if patch is None else patch
        frame = Frame(np.asarray(centre, np.float64), axes)
        red, green, blue = (float(part) for part in tint)
        place = (float(start[0]), float(start[1]))
        self.solids.append(Solid(shape, frame, material, (red, green, blue), place, casts_shadow))

    def sun(self, towards: Vector, color: Vector) -> None:
        x, y, z = np.asarray(towards, np.float64) / np.linalg.norm(towards)
        self.suns.append(Sun((float(x), float(y), float(z)), (color[0], color[1], color[2])))

    def lamp(self, position: Vector, color: Vector, reach: float) -> None:
        place = (position[0], position[1], position[2])
        self.lamps.append(Lamp(place, (color[0], color[1], color[2]), reach))

    def tone(self, strength: float = 0.15) -> Float32[np.ndarray, " 3"]:
        """A random tint in [(1 - strength) / (1 + strength), 1], so that no two solids look alike."""
        return (1 + strength * (self.generator.random(3, dtype=np.float32) * 2 - 1)) / (1 + strength)

    def world(self, sky: Sky) -> World:
        return World(tuple(self.solids), tuple(self.pages), tuple(self.suns), tuple(self.lamps), sky)
