"""The rasterizer: Gaussians with features in, a picture of features out, differentiable and reproducible."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.blending import LARGEST_FEATURE_DIM, Blend
from opencl.contract import RasterOutput, RasterSettings
from opencl.projection import Project, pack_camera
from opencl.routes import backend_for
from opencl.tiling import sort_into_tiles
from opencl.validation import check_arguments

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
    settings: RasterSettings = RasterSettings(),  # noqa: B008 (frozen)
) -> RasterOutput:
    """Draw Gaussians as one camera sees them: splatting by the local affine approximation, blended front to back.

    Args:
        means: centres in world units. All tensors are of one type, float32 or float64.
        quats: orientations w x y z, from the Gaussian's axes to the world's; normalised inside.
        scales: standard deviations along the axes, in world units, activated (not their logarithm).
        opacities: in [0, 1], activated.
        features: what is blended, of any dimension M of at least 1.
        world_to_camera: rigid, the camera looking down +z with x right and y down. No gradient.
        intrinsics: pinhole without skew, in pixels; pixel centres at +0.5. No gradient.
        width, height: of the picture in pixels.
        background: what is seen where nothing covers a pixel; zeros where None.
        settings: every constant; the defaults are 3DGS's.

    Returns:
        A picture of `height` by `width` pixels of M features, its alphas, and for density control radii and centres on
        the screen (see `RasterOutput`). With no Gaussian, or none in view: the background. Gradients reach means,
        quats, scales, opacities, features and background, from features, alphas and means2d. A Gaussian with a value
        that is not finite, or a zero quaternion, is not visible and gets no gradient.

    The same inputs on the same device give the same bits, forward and backward, for any number of threads. Tensors of
    the CPU are drawn by `opencl.device.choose_device()`'s device, CUDA tensors of an NVIDIA GPU by that GPU, in place;
    which device draws others, and when tensors are copied, `opencl.routes.backend_for` says.

    Raises:
        ValueError: shapes, types, devices or a camera that do not fit; no OpenCL device, or not the one asked for.
        RuntimeError: more than 2^31 - 1 pairs of a tile and a Gaussian.
    """
    check_arguments(
        means, quats, scales, opacities, features, world_to_camera, intrinsics, width, height, background, settings
    )
    background = features.new_zeros(features.shape[1]) if background is None else background
    return _rasterize_on(
        *(backend_for(means.device), means, quats, scales, opacities, features),
        *(world_to_camera, intrinsics, width, height, background, settings),
    )


def _rasterize_on(
    backend: Backend,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
    background: Tensor,
    settings: RasterSettings,
) -> RasterOutput:
    device, size = means.device, (width, height)
    means, quats, scales, opacities, features, background = (
        backend.memory.receive(tensor) for tensor in (means, quats, scales, opacities, features, background)
    )
    camera = backend.memory.receive(pack_camera(world_to_camera, intrinsics, width, height, settings))
    means2d, records, radii, depth_keys = Project.apply(
        backend, settings, camera, size, means, quats, scales, opacities, features
    )
    lists = sort_into_tiles(backend, settings, width, height, records.detach(), radii, depth_keys)
    means2d_out = means2d.to(device)
    if means2d_out.requires_grad:
        means2d_out.retain_grad()
    parts, behinds = [features], [background]
    if features.shape[1] > LARGEST_FEATURE_DIM:
        parts = [backend.memory.receive(part) for part in features.split(LARGEST_FEATURE_DIM, dim=1)]
        behinds = [backend.memory.receive(part) for part in background.split(LARGEST_FEATURE_DIM)]
    centres = means2d_out.to(backend.tensor_device)
    passes = [
        Blend.apply(backend, settings, lists, size, centres, records, part, behind)
        for part, behind in zip(parts, behinds, strict=True)
    ]
    feature_map = passes[0][0] if len(passes) == 1 else torch.cat([one[0] for one in passes], dim=-1)
    with backend.session() as session:
        (radii,) = session.give(radii)
    return RasterOutput(feature_map.to(device), passes[0][1].to(device), radii.to(device), means2d_out)
