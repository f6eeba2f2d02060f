"""Assigns Gaussians to the tiles of a picture, sorted by depth."""

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
    """Compute the tile lists of a picture from projected Gaussians, as returned by `Project`.

    Args:
        width, height: size of the picture in pixels.
        records: as described in real.cl, in the type in which the kernels compute.
        radii: in pixels. Gaussians of radius 0 are in no list.
        depth_keys: the bits of the depths as int32 or int64, which sort like the depths.
        for_gradients: whether to compute slots.

    The order of the slots depends on the schedule. Without Gaussians, all lists are empty. Raises RuntimeError for more
    than 2^31 - 1 entries.
    """
    sort = sort_into_tiles_on_cpu if backend.schedule == "cpu" else sort_into_tiles_on_gpu
    return sort(backend, settings, width, height, records, radii, depth_keys, for_gradients)
