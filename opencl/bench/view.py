"""A camera with the size of its picture."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class View:
    """A camera that looks down +z, with x right and y down. Intrinsics and sizes are in pixels."""

    world_to_camera: Float[Tensor, "4 4"]
    intrinsics: Float[Tensor, "3 3"]
    width: int
    height: int

    @property
    def arguments(self) -> tuple[Tensor, Tensor, int, int]:
        """The fields in the order of the rasterizer's arguments."""
        return self.world_to_camera, self.intrinsics, self.width, self.height
