"""A rasterizer from gsplat's plain-torch reference, with its CUDA-only parts and Python loops replaced by torch.

gsplat's own code projects, evaluates alpha and composes the picture (`gsplat/cuda/_torch_impl.py`, 1.5.3). Ours finds
the (tile, Gaussian) and (pixel, Gaussian) pairs, and replaces the two functions of nerfacc that gsplat calls.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any
from unittest import mock

import torch
from jaxtyping import Float, Int
from torch import Tensor

from opencl.bench.pairs import Footprints, Thresholds, contributing_pairs, tile_entries
from opencl.contract import RasterOutput, RasterSettings

SETTINGS = RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")
_THRESHOLDS = Thresholds(alpha_minimum=1 / 255, alpha_maximum=0.999, transmittance_minimum=1e-4)
_TILE = 16


def rasterize_gsplat(
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
    """`opencl.rasterizer.rasterize` for one camera and `SETTINGS`. Radii are gsplat's for the wider of x and y.

    Raises ValueError for other settings, and ImportError if gsplat is not installed.
    """
    if settings != SETTINGS:
        raise ValueError(f"settings: found {settings}, expected gsplat's: {SETTINGS}")
    gsplat = importlib.import_module("gsplat.cuda._torch_impl")
    covariances, _ = gsplat._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    (radii,), (means2d,), (depths,), (conics,) = gsplat._fully_fused_projection(
        means, covariances, world_to_camera[None], intrinsics[None], width, height
    )[:4]
    if means2d.requires_grad:
        means2d.retain_grad()
    footprints = Footprints(
        *(means2d.detach(), conics.detach(), opacities.detach(), radii.to(means.dtype), depths.detach()),
        visible=(radii > 0).all(dim=-1),
    )
    tiles, gaussians = tile_entries(footprints, width, height, _TILE)
    columns, rows = -(-width // _TILE), -(-height // _TILE)
    offsets = torch.searchsorted(tiles, torch.arange(columns * rows)).reshape(1, rows, columns).int()
    with _plain_torch_parts():
        (rendered,), (alphas,) = gsplat._rasterize_to_pixels(
            *(means2d[None], conics[None], features[None], opacities[None], width, height, _TILE, offsets),
            gaussians.int(),
            backgrounds=None if background is None else background[None],
        )
    return RasterOutput(rendered, alphas[..., 0], radii.amax(dim=-1), means2d)


@contextmanager
def _plain_torch_parts() -> Iterator[None]:
    """Substitute the functions below for gsplat's CUDA kernel and for nerfacc."""
    nerfacc = ModuleType("nerfacc")
    vars(nerfacc).update(render_weight_from_alpha=weights_from_alphas, accumulate_along_rays=accumulate_along_rays)
    wrapper = importlib.import_module("gsplat.cuda._wrapper")
    with (
        mock.patch.dict(sys.modules, nerfacc=nerfacc),
        mock.patch.object(wrapper, "rasterize_to_indices_in_range", _pairs_in_range),
    ):
        yield


def _pairs_in_range(
    range_start: int,
    range_end: int,
    transmittances: Float[Tensor, "1 height width"],
    means2d: Float[Tensor, "1 N 2"],
    conics: Float[Tensor, "1 N 3"],
    opacities: Float[Tensor, "1 N"],
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Int[Tensor, "1 rows columns"],
    flatten_ids: Int[Tensor, " E"],
) -> tuple[Tensor, Tensor, Tensor]:
    """(Gaussians, pixels, pictures) drawn by blocks `range_start` up to `range_end` of 256 entries of each tile."""
    with torch.no_grad():
        starts = isect_offsets.flatten().long()
        lengths = torch.diff(starts, append=starts.new_tensor([len(flatten_ids)]))
        tiles = torch.repeat_interleave(torch.arange(len(starts)), lengths)
        block = (torch.arange(len(flatten_ids)) - starts[tiles]) // (tile_size * tile_size)
        chosen = (block >= range_start) & (block < range_end)
        unused = (torch.zeros_like(means2d[0]), torch.zeros_like(opacities[0]), torch.ones_like(opacities[0]).bool())
        footprints = Footprints(means2d[0], conics[0], opacities[0], *unused)
        gaussians, pixels = contributing_pairs(
            *(footprints, tiles[chosen], flatten_ids.long()[chosen], image_width, image_height, tile_size),
            *(transmittances.flatten(), _THRESHOLDS),
        )
    return gaussians, pixels, torch.zeros_like(pixels)


def weights_from_alphas(
    alphas: Float[Tensor, " P"], ray_indices: Int[Tensor, " P"], n_rays: int, **_: Any
) -> tuple[Float[Tensor, " P"], Float[Tensor, " P"]]:
    """nerfacc's `render_weight_from_alpha`: (weights, transmittances in front) of alphas sorted by ray, nearest first.

    The product along each ray is the exponential of a difference in a single running sum of logarithms. It is computed
    in float64, because the sum grows large.
    """
    logarithms = torch.log1p(-alphas.double())
    before = logarithms.cumsum(0) - logarithms
    _, lengths = torch.unique_consecutive(ray_indices, return_counts=True)
    starts = lengths.cumsum(0) - lengths
    transmittances = (before - torch.repeat_interleave(before[starts], lengths)).exp().to(alphas.dtype)
    return alphas * transmittances, transmittances


def accumulate_along_rays(
    weights: Float[Tensor, " P"], values: Float[Tensor, "P D"] | None, ray_indices: Int[Tensor, " P"], n_rays: int
) -> Float[Tensor, "rays D"]:
    """nerfacc's function of this name: sums of weighted values (None: of weights) per ray, sorted by ray."""
    terms = weights[:, None] if values is None else weights[:, None] * values
    lengths = torch.bincount(ray_indices, minlength=n_rays)
    return torch.segment_reduce(terms, "sum", lengths=lengths, unsafe=True)
