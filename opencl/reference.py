"""The rasterizer in plain torch, slow and simple: the reference against which the kernels are tested.

Works in any floating-point type. Autograd computes the gradients; nothing here is differentiated by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from opencl.contract import RasterOutput, RasterSettings, half_fields_of_view


@dataclass(frozen=True)
class ProjectedGaussians:
    """All Gaussians on the screen. The values of invisible ones are placeholders that get no gradient."""

    visible: Bool[Tensor, " N"]
    depths: Float[Tensor, " N"]
    means: Float[Tensor, "N 2"]
    covariances: Float[Tensor, "N 2 2"]
    opacities: Float[Tensor, " N"]
    """After compensation if `antialiased`."""
    radii: Int[Tensor, " N"]
    half_heights: Float[Tensor, " N"]


def rotations_of(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Rotation matrices of quaternions w x y z, of any non-zero length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1, eps=0.0).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def _drawable(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, features: Tensor, view: Tensor, near: float
) -> Bool[Tensor, " N"]:
    """Whether all values are finite, the quaternion is not zero and the centre lies beyond the near plane."""
    everything = torch.cat([means, quats, scales, opacities[:, None], features], dim=-1)
    depths = means @ view[2, :3] + view[2, 3]
    return everything.isfinite().all(-1) & (quats.square().sum(-1) > 0) & (depths > near)


def project_reference(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    opacities: Float[Tensor, " N"],
    features: Float[Tensor, "N M"],
    world_to_camera: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    width: int,
    height: int,
    settings: RasterSettings,
) -> ProjectedGaussians:
    """Project Gaussians by the local affine approximation (EWA splatting, Zwicker et al. 2001)."""
    drawable = _drawable(means, quats, scales, opacities, features, world_to_camera, settings.near)
    means = torch.where(drawable[:, None], means, world_to_camera.new_zeros(3))
    quats = torch.where(drawable[:, None], quats, quats.new_tensor([1.0, 0.0, 0.0, 0.0]))
    scales = torch.where(drawable[:, None], scales, 0.0)

    rotation = world_to_camera[:3, :3]
    in_camera = means @ rotation.T + world_to_camera[:3, 3]
    in_camera = torch.where(drawable[:, None], in_camera, in_camera.new_tensor([0.0, 0.0, 1.0]))
    x, y, z = in_camera.unbind(-1)
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    screen = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)

    left, right, top, bottom = half_fields_of_view(intrinsics, width, height, settings)
    clamped_x, clamped_y = (x / z).clamp(left, right), (y / z).clamp(top, bottom)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * clamped_x / z, zero, fy / z, -fy * clamped_y / z], dim=-1)
    axes = jacobian.reshape(-1, 2, 3) @ rotation @ rotations_of(quats) * scales[:, None, :]
    unfiltered = axes @ axes.transpose(-1, -2)
    covariances = unfiltered + settings.low_pass * torch.eye(2, dtype=means.dtype)
    if settings.antialiased:
        areas = torch.linalg.det(unfiltered)
        flat = areas <= 0
        ratios = torch.where(flat, 1.0, areas) / torch.linalg.det(covariances)
        opacities = opacities * torch.where(flat, 0.0, ratios.sqrt())

    reach = 2 * (opacities.detach() / settings.alpha_minimum).clamp_min(1e-30).log()
    variance_x, variance_y = covariances[:, 0, 0].detach(), covariances[:, 1, 1].detach()
    half_widths, half_heights = (reach * variance_x).clamp_min(0).sqrt(), (reach * variance_y).clamp_min(0).sqrt()
    visible = (
        drawable
        & (reach >= 0)
        & covariances.detach().isfinite().all(-1).all(-1)
        & _holds_a_pixel(screen[:, 0].detach(), half_widths, width)
        & _holds_a_pixel(screen[:, 1].detach(), half_heights, height)
    )
    middle = 0.5 * (variance_x + variance_y)
    covariance_xy = covariances[:, 0, 1].detach()
    longest = (middle + (0.25 * (variance_x - variance_y).square() + covariance_xy.square()).sqrt()).sqrt()
    radii = torch.where(visible, (settings.radius_sigmas * longest).ceil(), 0.0).clamp_max(2**30).to(torch.int32)
    screen = torch.where(visible[:, None], screen, 0.0)
    return ProjectedGaussians(visible, z.detach(), screen, covariances, opacities, radii, half_heights)


def _holds_a_pixel(centre: Tensor, half_length: Tensor, size: int) -> Bool[Tensor, " N"]:
    """Whether any of the pixel centres 0.5, 1.5, …, size - 0.5 lies within `half_length` of `centre`."""
    first = (centre - half_length - 0.5).ceil().clamp_min(0)
    last = (centre + half_length - 0.5).floor().clamp_max(size - 1)
    return first <= last


def _blend_row(
    gaussians: ProjectedGaussians,
    features: Tensor,
    background: Tensor,
    row: int,
    width: int,
    settings: RasterSettings,
) -> tuple[Float[Tensor, "width M"], Float[Tensor, " width"]]:
    """Blend one row of pixels front to back. `gaussians` must be sorted by depth."""
    columns = torch.arange(width, dtype=features.dtype) + 0.5
    dx = columns[None, :] - gaussians.means[:, 0, None]
    dy = row + 0.5 - gaussians.means[:, 1, None]
    inverse = torch.linalg.inv(gaussians.covariances)
    power = -0.5 * (
        inverse[:, 0, 0, None] * dx * dx + inverse[:, 1, 1, None] * dy * dy + 2 * inverse[:, 0, 1, None] * dx * dy
    )
    alphas = (gaussians.opacities[:, None] * power.exp()).clamp_max(settings.alpha_maximum)
    alphas = torch.where(alphas >= settings.alpha_minimum, alphas, 0.0)
    finished = torch.cumprod(1 - alphas.detach(), dim=0) < settings.transmittance_minimum
    alphas = torch.where(finished, 0.0, alphas)
    after = torch.cumprod(1 - alphas, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    blended = (before * alphas).T @ features
    return blended + after[-1:].T * background, 1 - after[-1]


def rasterize_reference(
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
    """`opencl.rasterizer.rasterize` for one camera, without its argument checks and its keyword-only options."""
    settings = settings or RasterSettings()
    background = features.new_zeros(features.shape[1]) if background is None else background
    projected = project_reference(
        means, quats, scales, opacities, features, world_to_camera, intrinsics, width, height, settings
    )
    if projected.means.requires_grad:
        projected.means.retain_grad()
    shown = projected.visible.nonzero().squeeze(-1)
    order = shown[torch.sort(projected.depths[shown], stable=True).indices]
    feature_rows, alpha_rows = [], []
    for row in range(height):
        # With a margin of one pixel, because alpha alone decides in _blend_row which pixels are drawn.
        near_row = (row + 0.5 - projected.means[order, 1]).abs() <= projected.half_heights[order] + 1
        chosen = order[near_row]
        if len(chosen) == 0:
            feature_rows.append(background.expand(width, -1))
            alpha_rows.append(features.new_zeros(width))
            continue
        gaussians = ProjectedGaussians(
            projected.visible[chosen],
            projected.depths[chosen],
            projected.means[chosen],
            projected.covariances[chosen],
            projected.opacities[chosen],
            projected.radii[chosen],
            projected.half_heights[chosen],
        )
        blended, covered = _blend_row(gaussians, features[chosen], background, row, width, settings)
        feature_rows.append(blended)
        alpha_rows.append(covered)
    return RasterOutput(torch.stack(feature_rows), torch.stack(alpha_rows), projected.radii, projected.means)
