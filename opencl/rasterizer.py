"""The rasterizer: Gaussians with features in, a picture of features out, differentiable and reproducible."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from opencl.contract import RasterOutput, RasterSettings
from opencl.reference import rasterize_reference

__all__ = ["RasterOutput", "RasterSettings", "rasterize"]


def rasterize(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    opacities: Float[Tensor, " N"],
    features: Float[Tensor, "N M"],
    world_to_camera: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    width: int,
    height: int,
    background: Float[Tensor, " M"] | None = None,
    settings: RasterSettings | None = None,
) -> RasterOutput:
    """Draw Gaussians as one camera sees them (a picture of `height` by `width` pixels with M channels)."""
    return rasterize_reference(
        means, quats, scales, opacities, features, world_to_camera, intrinsics, width, height, background, settings
    )
