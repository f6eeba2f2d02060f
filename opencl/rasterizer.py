"""The rasterizer: renders Gaussians with features of any dimension, differentiably and reproducibly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from opencl.backend import Backend
from opencl.blending import LARGEST_FEATURE_DIM, Blend
from opencl.contract import RasterOutput, RasterSettings
from opencl.memory import moved
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
    world_to_camera: Float[Tensor, "*cameras 4 4"],
    intrinsics: Float[Tensor, "*cameras 3 3"],
    width: int,
    height: int,
    background: Float[Tensor, "*cameras M"] | Float[Tensor, " M"] | None = None,
    settings: RasterSettings = RasterSettings(),  # noqa: B008 (frozen)
    *,
    depth: bool = False,
    absolute_gradients: bool = False,
    count_pixels: bool = False,
) -> RasterOutput:
    """Render Gaussians for one camera or a batch: EWA splatting (local affine approximation), blended front to back.

    Args:
        means: centres in world space. All tensors must have the same type, float32 or float64.
        quats: rotations w x y z from the Gaussian's frame to the world's. Normalised internally.
        scales: standard deviations along the Gaussian's axes, in world units, activated (not their logarithms).
        opacities: in [0, 1], activated.
        features: the values to blend, of any dimension M >= 1.
        world_to_camera: rigid transform. The camera looks down +z, with x right and y down. No gradient. [4,4], or
            [C,4,4] for a batch of C cameras of the same picture size: all outputs then have a leading dimension C. It
            is read on the host, which must wait for it if it is on a GPU.
        intrinsics: pinhole without skew, in pixels, with pixel centres at +0.5. No gradient. [3,3] or [C,3,3].
        width, height: size of a picture in pixels.
        background: value behind all Gaussians, [M] or [C,M]. Zeros if None.
        settings: all constants. The defaults are those of 3DGS.
        depth: return `depths`: the depths of the centres, blended like features over a background of 0.
        absolute_gradients: provide `absolute_gradients`: sums, over pixels, of the absolute values of the screen-space
            gradient (AbsGS, Ye et al. 2024). For M up to 64, or 63 with `depth`.
        count_pixels: return `pixel_counts`: the number of pixels in which each Gaussian is drawn.

    Returns:
        A picture [height,width,M] of features, its alphas, and screen-space radii and centres for density control (see
        `RasterOutput`). Without Gaussians, or with none in view, the picture is the background. Gradients of features,
        alphas, depths and means2d reach means, quats, scales, opacities, features and background. A Gaussian with a
        non-finite value or a zero quaternion is invisible and gets no gradient. Gradients of means, quats, scales and
        opacities are clamped to the finite range. If nothing requires a gradient, or under `torch.no_grad`,
        nothing is kept for a backward pass.

    The same inputs on the same device give the same bits, forward and backward, for any number of threads. CPU tensors
    are drawn by the device of `opencl.device.choose_device()`, CUDA tensors on an NVIDIA GPU by that GPU, in place.
    `opencl.routes.backend_for` documents which device draws other tensors, and when tensors are copied.

    Raises:
        ValueError: wrong shapes, types or devices; an invalid camera (transposed, not finite, or requiring a gradient);
            a background on the CPU that is not finite (one on a GPU is not checked); more features than
            `absolute_gradients` allows; no OpenCL device, or not the requested one.
        RuntimeError: more than 2^31 - 1 (tile, Gaussian) pairs, or too little memory on the device.
    """
    check_arguments(
        means, quats, scales, opacities, features, world_to_camera, intrinsics, width, height, background, settings
    )
    if absolute_gradients and features.shape[1] + depth > LARGEST_FEATURE_DIM:
        raise ValueError(
            f"absolute_gradients: found {features.shape[1] + depth} features (depth is one), expected at most "
            f"{LARGEST_FEATURE_DIM}, as they are not the sum of several passes' ones: draw without absolute_gradients"
        )
    background = features.new_zeros(features.shape[1]) if background is None else background
    return _rasterize_on(
        *(backend_for(means.device), means, quats, scales, opacities, features),
        *(world_to_camera, intrinsics, width, height, background, settings),
        depth=depth,
        absolute_gradients=absolute_gradients,
        count_pixels=count_pixels,
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
    *,
    depth: bool = False,
    absolute_gradients: bool = False,
    count_pixels: bool = False,
) -> RasterOutput:
    device, batch = means.device, world_to_camera.shape[:-2]
    inputs = (means, quats, scales, opacities, features)
    differentiated = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (*inputs, background))
    drawing = _Drawing(backend, settings, (width, height), means, features, depth, differentiated)
    views = _views(drawing, world_to_camera, intrinsics, background)
    received = [backend.memory.receive(tensor) for tensor in inputs]
    projections = [Project.apply(backend, settings, view.camera, drawing.size, *received) for view in views]
    means2d = _stacked([projection[0] for projection in projections], batch).to(device)
    if means2d.requires_grad:
        means2d.retain_grad()
    absolute = torch.zeros_like(means2d, requires_grad=means2d.requires_grad) if absolute_gradients else None

    centres = _one_by_one(means2d.to(backend.tensor_device), batch)
    wanted: Sequence[Tensor | None] = [None] * len(views)
    if absolute is not None:
        wanted = _one_by_one(absolute.to(backend.tensor_device), batch)
    counts = [backend.memory.zeros(len(means) if count_pixels else 0, dtype=torch.int32) for _ in views]
    pictures = [
        drawing.blend(view, received[-1], projections[index], centres[index], wanted[index], counts[index])
        for index, view in enumerate(views)
    ]
    with backend.session() as session:
        radii = session.give(*(projection[2] for projection in projections))
        pixel_counts = session.give(*counts)
    feature_map = _stacked([picture[0] for picture in pictures], batch).to(device)
    return RasterOutput(
        features=feature_map[..., :-1].contiguous() if depth else feature_map,
        alphas=_stacked([picture[1] for picture in pictures], batch).to(device),
        radii=_stacked(radii, batch).to(device),
        means2d=means2d,
        depths=feature_map[..., -1] if depth else None,
        absolute_gradients=absolute,
        pixel_counts=_stacked(pixel_counts, batch).to(device) if count_pixels else None,
    )


@dataclass(frozen=True)
class _View:
    """A camera, its parameters in the kernels' layout (`camera`), and the background of its picture."""

    world_to_camera: Float[Tensor, "4 4"]
    camera: Float[Tensor, " 20"]
    background: Float[Tensor, " M"]


@dataclass(frozen=True)
class _Drawing:
    """Inputs that the pictures of all cameras share."""

    backend: Backend
    settings: RasterSettings
    size: tuple[int, int]
    means: Float[Tensor, "N 3"]
    features: Float[Tensor, "N M"]
    """Like `means`, the caller's own tensor."""
    depth: bool
    differentiated: bool

    def blend(
        self,
        view: _View,
        features: Float[Tensor, "N M"],
        projection: Sequence[Tensor],
        centres: Float[Tensor, "N 2"],
        absolute: Float[Tensor, "N 2"] | None,
        pixel_counts: Int[Tensor, " counted"],
    ) -> tuple[Tensor, Tensor]:
        """Blend one camera's features, followed by the depth if requested, in passes. Returns features and alphas."""
        _, records, radii, depth_keys = projection
        lists = sort_into_tiles(
            *(self.backend, self.settings, *self.size, records.detach(), radii, depth_keys, self.differentiated)
        )
        background = view.background
        if self.depth:
            features = self.backend.memory.receive(torch.cat([self.features, self._depths(view)], dim=1))
            background = torch.cat([background, background.new_zeros(1)])
        passes: list[tuple[Tensor, Tensor]] = []
        parts = self._parts(features, 1)
        for part, behind in zip(parts, self._parts(background, 0), strict=True):
            counted = pixel_counts[:0] if passes else pixel_counts
            fixed = (self.backend, self.settings, lists, self.size, counted, len(parts) == 1)
            passes.append(Blend.apply(*fixed, centres, absolute, records, part, behind))
        feature_map = passes[0][0] if len(passes) == 1 else torch.cat([one[0] for one in passes], dim=-1)
        return feature_map, passes[0][1]

    def _depths(self, view: _View) -> Float[Tensor, "N 1"]:
        # Not by a matrix product: its rounding depends on the number of threads, and autocast makes it half as precise.
        forward = moved(view.world_to_camera, self.means.device)[2]
        x, y, z = self.means.unbind(1)
        return (x * forward[0] + y * forward[1] + z * forward[2] + forward[3])[:, None]

    def _parts(self, channels: Tensor, axis: int) -> Sequence[Tensor]:
        if channels.shape[axis] <= LARGEST_FEATURE_DIM:
            return [channels]
        return [self.backend.memory.receive(part) for part in channels.split(LARGEST_FEATURE_DIM, dim=axis)]


def _views(drawing: _Drawing, world_to_camera: Tensor, intrinsics: Tensor, background: Tensor) -> list[_View]:
    poses, calibrations = world_to_camera.reshape(-1, 4, 4), intrinsics.reshape(-1, 3, 3)
    receive = drawing.backend.memory.receive
    behind = receive(background).expand(*world_to_camera.shape[:-2], -1).reshape(len(poses), -1)
    return [
        _View(pose, receive(pack_camera(pose, calibration, *drawing.size, drawing.settings)), one)
        for pose, calibration, one in zip(poses, calibrations, behind, strict=True)
    ]


def _stacked(tensors: Sequence[Tensor], batch: Sequence[int]) -> Tensor:
    """Stack the tensors of a batch of cameras. Without a batch, return the only one."""
    return torch.stack(list(tensors)) if batch else tensors[0]


def _one_by_one(tensor: Tensor, batch: Sequence[int]) -> list[Tensor]:
    return list(tensor.unbind()) if batch else [tensor]
