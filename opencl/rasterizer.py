"""The rasterizer: Gaussians with features in, a picture of features out, differentiable and reproducible."""

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
    background: Float[Tensor, "*cameras M"] | None = None,
    settings: RasterSettings = RasterSettings(),  # noqa: B008 (frozen)
    *,
    depth: bool = False,
    absolute_gradients: bool = False,
    count_pixels: bool = False,
) -> RasterOutput:
    """Draw Gaussians as cameras see them: splatting by the local affine approximation, blended front to back.

    Args:
        means: centres in world units. All tensors are of one type, float32 or float64.
        quats: orientations w x y z, from the Gaussian's axes to the world's; normalised inside.
        scales: standard deviations along the axes, in world units, activated (not their logarithm).
        opacities: in [0, 1], activated.
        features: what is blended, of any dimension M of at least 1.
        world_to_camera: rigid, the camera looking down +z with x right and y down. No gradient. One camera, or [C,4,4]
            for a batch of C cameras that draw pictures of one size; every output then begins with C. It is read on the
            CPU: one on a GPU is waited for.
        intrinsics: pinhole without skew, in pixels; pixel centres at +0.5. No gradient. [3,3] or [C,3,3].
        width, height: of a picture in pixels.
        background: what is seen where nothing covers a pixel, one for all cameras or [C,M]; zeros where None.
        settings: every constant; the defaults are 3DGS's.
        depth: whether `depths` are wanted: the centres' depths, blended as features are, over a background of 0.
        absolute_gradients: whether `absolute_gradients` are wanted: sums over the pixels of the screen-space gradient's
            absolute values (AbsGS, Ye et al. 2024). For M up to 64 (with depth, 63).
        count_pixels: whether `pixel_counts` are wanted: in how many pixels each Gaussian is drawn.

    Returns:
        A picture of `height` by `width` pixels of M features, its alphas, and for density control radii and centres on
        the screen (see `RasterOutput`). With no Gaussian, or none in view: the background. Gradients reach means,
        quats, scales, opacities, features and background, from features, alphas, depths and means2d. A Gaussian with
        a value that is not finite, or a zero quaternion, is not visible and gets no gradient. A gradient of means,
        quats, scales or opacities beyond the largest number is that number. Where nothing requires a gradient, or
        under `torch.no_grad`, nothing is kept for a backward pass.

    The same inputs on the same device give the same bits, forward and backward, for any number of threads. Tensors of
    the CPU are drawn by `opencl.device.choose_device()`'s device, CUDA tensors of an NVIDIA GPU by that GPU, in place;
    which device draws others, and when tensors are copied, `opencl.routes.backend_for` says.

    Raises:
        ValueError: shapes, types, devices or a camera that do not fit; a camera that is not finite, or a background on
            the CPU that is not (on a GPU it is not looked at); a transposed camera; no OpenCL device, or not the one
            asked for.
        RuntimeError: more than 2^31 - 1 pairs of a tile and a Gaussian, or no room for them on the device.
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
    """A camera, also as the kernels read it, and what its picture is blended over."""

    world_to_camera: Float[Tensor, "4 4"]
    camera: Float[Tensor, " 20"]
    background: Float[Tensor, " M"]


@dataclass(frozen=True)
class _Drawing:
    """What all cameras' pictures have in common."""

    backend: Backend
    settings: RasterSettings
    size: tuple[int, int]
    means: Float[Tensor, "N 3"]
    features: Float[Tensor, "N M"]
    """These two as the caller gave them."""
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
        """One camera's features (the last of them the depth, where it is wanted) and alphas, in passes of channels."""
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
        pose = moved(view.world_to_camera, self.means.device)
        return (self.means @ pose[2, :3] + pose[2, 3])[:, None]

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
    """One camera's tensor as it is, or a batch of them."""
    return torch.stack(list(tensors)) if batch else tensors[0]


def _one_by_one(tensor: Tensor, batch: Sequence[int]) -> list[Tensor]:
    return list(tensor.unbind()) if batch else [tensor]
