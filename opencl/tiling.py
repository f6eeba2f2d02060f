"""Which Gaussians each tile of the picture draws, nearest first."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.tile_lists import TileLists
from opencl.tiling_cpu import sort_into_tiles_on_cpu
from opencl.tiling_gpu import sort_into_tiles_on_gpu

__all__ = ["TileLists", "sort_into_tiles"]


def sort_into_tiles(
    backend: Backend,
    settings: RasterSettings,
    width: int,
    height: int,
    records: Float[Tensor, "N 8"],
    radii: Int[Tensor, " N"],
    depth_keys: Int[Tensor, " N"],
    for_gradients: bool,
) -> TileLists:
    """Lists for every tile, of Gaussians on the screen as `Project` returns them.

    Args:
        width, height: of the picture in pixels.
        records: as described in real.cl, of the type that the kernels compute in.
        radii: in pixels; Gaussians of radius 0 are in no list.
        depth_keys: the bits of their depths, which sort as the depths do, as int32 or int64.
        for_gradients: whether slots are needed.

    Which slot a (tile, Gaussian) has is the schedule's own choice. With no Gaussian all lists are empty. `RuntimeError`
    where they would hold more than 2^31 - 1 entries.
    """
    sort = sort_into_tiles_on_cpu if backend.schedule == "cpu" else sort_into_tiles_on_gpu
    return sort(backend, settings, width, height, records, radii, depth_keys, for_gradients)
