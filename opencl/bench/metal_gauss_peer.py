"""metal-gauss's plain-torch reference (`metal_gauss/torch_ref.py`, 0.2.1) as a rasterizer, on its fastest tiles."""

from __future__ import annotations

import importlib

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.contract import RasterOutput, RasterSettings

SETTINGS = RasterSettings(near=0.01, alpha_maximum=0.999, transmittance_minimum=0.0)
CHANNELS = 3
"""Number of features that it draws at a time."""
_TILE = 16
_FAR = 1e10
_ANY_RADIUS = 1e10
"""Largest size of a Gaussian that is drawn, relative to the longer side of the picture: effectively no limit."""
_ALL_OF_A_TILE = 2**31 - 1


def rasterize_metal_gauss(
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
    settings: RasterSettings = SETTINGS,
) -> RasterOutput:
    """`opencl.rasterizer.rasterize` for one camera and `SETTINGS`.

    A Gaussian is not drawn in tiles farther from its centre than 3 sigma of its longer axis. More than three features
    are drawn in several passes. Raises ValueError for other settings, and ImportError if metal-gauss is not installed.
    """
    if settings != SETTINGS:
        raise ValueError(f"settings: found {settings}, expected metal-gauss's: {SETTINGS}")
    metal_gauss = importlib.import_module("metal_gauss.torch_ref")
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    means2d, conics, depths, radii, visible, _ = metal_gauss.project(
        *(means, metal_gauss.build_cov3d(quats, scales), world_to_camera, fx, fy, cx, cy, width, height),
        near=settings.near,
        far=_FAR,
        max_radius_frac=_ANY_RADIUS,
    )
    if means2d.requires_grad:
        means2d.retain_grad()
    parts = features.split(CHANNELS, dim=1)
    passes = [
        metal_gauss.rasterize(
            *(means2d, conics, opacities, torch.nn.functional.pad(part, (0, CHANNELS - part.shape[1]))),
            *(depths, radii, visible, width, height),
            tile=_TILE,
            max_per_tile=_ALL_OF_A_TILE,
        )
        for part in parts
    ]
    pictures = [picture[..., : part.shape[1]] for (picture, _, _), part in zip(passes, parts, strict=True)]
    feature_map, alphas = torch.cat(pictures, dim=-1), passes[0][1]
    if background is not None:
        feature_map = feature_map + (1 - alphas)[..., None] * background
    return RasterOutput(feature_map, alphas, torch.where(visible, radii.ceil(), 0.0).int(), means2d)
