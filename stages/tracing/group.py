"""Groups of solids that are placed as one: a machine, a bench, the fittings of a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stages.tracing.world import Builder, Material, Vector, turned


@dataclass(frozen=True)
class Group:
    """Adds solids to `builder` in a local frame with its origin at `place` and the rows of `axes` as its axes."""

    builder: Builder
    place: Float64[np.ndarray, " 3"]
    axes: Float64[np.ndarray, "3 3"]

    @staticmethod
    def on_floor(builder: Builder, x: float, y: float, yaw: float) -> Group:
        return Group(builder, np.array([x, y, 0.0]), turned(yaw=yaw))

    def at(self, place: Vector) -> list[float]:
        return (self.place + np.asarray(place, np.float64) @ self.axes).tolist()

    def box(
        self,
        place: Vector,
        half: Vector,
        material: Material,
        turn: Vector = (0, 0, 0),
        patch: Vector | None = None,
    ) -> None:
        """Add a box with a random tone; `turn` is its yaw, pitch and roll within the group, in degrees."""
        axes, tint = turned(*turn) @ self.axes, self.builder.tone(0.12).tolist()
        bevel = 0.15 * min(half)
        self.builder.box(self.at(place), half, material, axes=axes, bevel=bevel, tint=tint, patch=patch)

    def rod(self, start: Vector, stop: Vector, radius: float, material: Material, end: float | None = None) -> None:
        tint = self.builder.tone(0.12).tolist()
        self.builder.rod(self.at(start), self.at(stop), radius, material, end_radius=end, tint=tint)

    def ball(self, place: Vector, half: Vector | float, material: Material) -> None:
        self.builder.ball(self.at(place), half, material, axes=self.axes, tint=self.builder.tone(0.12).tolist())

    def wheel(self, place: Vector, radius: float, width: float, tyre: Material, rim: Material) -> None:
        """Add a tyre with rounded shoulders and a rim, its axle along the group's y axis."""
        x, y, z = place
        self.rod((x, y - width, z), (x, y + width, z), radius, tyre)
        for side in (-width, width):
            self.rod((x, y + side, z), (x, y + 1.4 * side, z), radius, tyre, end=0.78 * radius)
        for out, part in ((1.5 * width, 0.56), (1.75 * width, 0.2)):
            self.rod((x, y - out, z), (x, y + out, z), part * radius, rim)
