"""Edits of a scene, as a workflow states them: recolour, remove or add an object."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.stage import Parameters
from stages.scene.regions import Shape

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Length = Annotated[float, Field(gt=0, le=1e6)]
Share = Annotated[float, Field(ge=0, le=1)]
Coordinates = Literal["rig", "world"]

COORDINATES = (
    "rig: the origin is where the cameras look, x right, y forwards, z upwards, and 1 is the cameras' median distance "
    "from it. world: those of the scene's world."
)


class EditedRegion(Parameters):
    """A region of space: an edit affects the Gaussians whose centres lie in it."""

    shape: Shape = Field(description="box or ellipsoid, along the axes of the coordinates.")
    centre: tuple[Coordinate, Coordinate, Coordinate] = Field((0.0, 0.0, 0.0), description="Its middle.")
    size: tuple[Length, Length, Length] = Field(description="From end to end, along each axis.")
    coordinates: Coordinates = Field("rig", description=COORDINATES)


class Recolour(Parameters):
    """Change colours, equally for all viewing directions. A recolour that changes nothing is refused."""

    edit: Literal["recolour"] = Field(description="recolour")
    hue: float = Field(0.0, ge=-360, le=360, description="Degrees by which hues turn, as by CSS's hue-rotate.")
    saturation: float = Field(1.0, ge=0, le=10, description="What saturation is multiplied by, as by CSS's saturate.")
    tint: tuple[Share, Share, Share] = Field(
        (1.0, 1.0, 1.0), description="A colour; each Gaussian takes it times its own luminance, so dark tints darken."
    )
    strength: Share = Field(0.0, description="The share of the tint; a tint needs one above 0.")
    region: EditedRegion | None = Field(None, description="Where; without it, everywhere.")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        """A message that equals the cover would show only after all of the training."""
        if self.strength == 0 and self.tint != (1.0, 1.0, 1.0):
            raise ValueError("has a tint of strength 0, which changes nothing; give a strength of up to 1")
        if self.strength == 0 and self.saturation == 1 and self.hue % 360 == 0:
            raise ValueError("changes nothing; give a hue, a saturation, or a tint with its strength")
        return self


class Remove(Parameters):
    """Remove the Gaussians in a region."""

    edit: Literal["remove"] = Field(description="remove")
    region: EditedRegion = Field(description="Where.")


class Add(Parameters):
    """Add splats, or the part of them in `only`, scaled and rotated about their own origin."""

    edit: Literal["add"] = Field(description="add")
    only: EditedRegion | None = Field(None, description="A part of the added splats' own space; without it, all.")
    scale: Length = Field(1.0, description="By which it is enlarged, in the coordinates.")
    turn: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (0.0, 0.0, 0.0), description="Degrees by which it turns about x, then about y, then about z."
    )
    place: tuple[Coordinate, Coordinate, Coordinate] = Field((0.0, 0.0, 0.0), description="Where its origin comes.")
    coordinates: Coordinates = Field("rig", description=COORDINATES)


Edit = Recolour | Remove | Add
