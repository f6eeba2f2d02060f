"""Counts the work of a picture, in pairs of Gaussians with tiles and pixels, independently of the rasterizer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyopencl
import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.bench.pairs import Footprints, half_sizes_of, tile_entries
from opencl.bench.view import View
from opencl.bench.workloads import Inputs
from opencl.contract import RasterSettings
from opencl.program import TILE
from opencl.reference import project_reference

_KERNEL = Path(__file__).with_name("counting.cl")


@dataclass(frozen=True)
class Counts:
    """Counts for one picture, or means over the views of a workload."""

    gaussians: int
    visible: int
    tile_pairs: int
    """(tile, Gaussian) pairs: the Gaussian alone would draw at least one pixel of the 16 x 16 tile."""
    evaluations: int
    """(pixel, Gaussian) pairs: all pixels of the tile, for each of the pairs above."""
    contributing: int
    """(pixel, Gaussian) pairs that are drawn: alpha is large enough, and the pixel is not finished."""
    pixels: int
    feature_dim: int
    mean_radius: float
    """Mean over the visible Gaussians of three standard deviations along the longer axis, in pixels."""


def count_work(backend: Backend, inputs: Inputs, settings: RasterSettings) -> Counts:
    """Count the work of a workload: means over its views."""
    each = [_count_view(backend, inputs, view, settings) for view in inputs.views]

    def mean(name: str) -> float:
        return sum(getattr(one, name) for one in each) / len(each)

    return Counts(
        gaussians=len(inputs.means),
        visible=round(mean("visible")),
        tile_pairs=round(mean("tile_pairs")),
        evaluations=round(mean("evaluations")),
        contributing=round(mean("contributing")),
        pixels=each[0].pixels,
        feature_dim=inputs.features.shape[1],
        mean_radius=mean("mean_radius"),
    )


def _count_view(backend: Backend, inputs: Inputs, view: View, settings: RasterSettings) -> Counts:
    footprints = _footprints(inputs, view, settings)
    drawing, contributing = _count_pairs(backend, footprints, view, settings)
    return Counts(
        gaussians=len(inputs.means),
        visible=int(footprints.visible.sum()),
        tile_pairs=int(drawing.sum()),
        evaluations=int((drawing * _pixels_of_tiles(view)).sum()),
        contributing=int(contributing.sum()),
        pixels=view.width * view.height,
        feature_dim=inputs.features.shape[1],
        mean_radius=_mean_radius(footprints),
    )


def _footprints(inputs: Inputs, view: View, settings: RasterSettings) -> Footprints:
    projected = project_reference(*inputs.trained, *view.arguments, settings)
    inverse = torch.linalg.inv(projected.covariances)
    conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], dim=-1)
    half_sizes = half_sizes_of(conics, inputs.opacities, settings.alpha_minimum)
    return Footprints(projected.means, conics, inputs.opacities, half_sizes, projected.depths, projected.visible)


def _mean_radius(footprints: Footprints) -> float:
    xx, xy, yy = footprints.conics[footprints.visible].unbind(-1)
    if len(xx) == 0:
        return 0.0
    determinant = xx * yy - xy * xy
    longest = (0.5 * (xx + yy) + (0.25 * (xx - yy).square() + xy * xy).sqrt()) / determinant
    return float(3 * longest.sqrt().mean())


def _pixels_of_tiles(view: View) -> Tensor:
    """Number of pixels of each tile, [tiles]; fewer at the right and lower borders."""
    columns, rows = ((side - torch.arange(0, side, TILE)).clamp_max(TILE) for side in (view.width, view.height))
    return (rows[:, None] * columns[None, :]).flatten()


def _count_pairs(
    backend: Backend, footprints: Footprints, view: View, settings: RasterSettings
) -> tuple[Tensor, Tensor]:
    """For each tile: the number of Gaussians that would draw in it, and of (pixel, Gaussian) pairs that contribute."""
    tiles, gaussians = tile_entries(footprints, view.width, view.height, TILE)
    count = len(_pixels_of_tiles(view))
    results = torch.zeros(2, count, dtype=torch.int32)
    if len(tiles) == 0:
        return results[0], results[1]
    starts = torch.searchsorted(tiles, torch.arange(count + 1)).int()
    program = pyopencl.Program(backend.context, _KERNEL.read_text(encoding="utf-8"))
    kernel = program.build(options=["-w", f"-DTILE={TILE}"], cache_dir=False).count_pairs
    flags = pyopencl.mem_flags.READ_WRITE | pyopencl.mem_flags.COPY_HOST_PTR
    tensors = (footprints.means2d, footprints.conics, footprints.opacities, starts, gaussians.int(), *results)
    buffers = [pyopencl.Buffer(backend.context, flags, hostbuf=tensor.contiguous().numpy()) for tensor in tensors]
    sizes = [np.int32(view.width), np.int32(view.height)]
    limits = (settings.alpha_minimum, settings.alpha_maximum, settings.transmittance_minimum)
    kernel(backend.queue, (count,), (1,), *sizes, *(np.float32(limit) for limit in limits), *buffers)
    for result, buffer in zip(results, buffers[-2:], strict=True):
        pyopencl.enqueue_copy(backend.queue, result.numpy(), buffer)
    return results[0], results[1]
