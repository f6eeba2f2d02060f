"""Tile lists on the CPU schedule: a radix sort by depth, then a counting sort by tile."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import TILING_RUNS, ProgramKey
from opencl.tile_lists import TileLists, check_entries, count_picture_tiles


def sort_into_tiles_on_cpu(
    backend: Backend,
    settings: RasterSettings,
    width: int,
    height: int,
    records: Float[Tensor, "N 8"],
    radii: Int[Tensor, " N"],
    depth_keys: Int[Tensor, " N"],
    for_gradients: bool,
) -> TileLists:
    """See `opencl.tiling.sort_into_tiles`."""
    count = len(radii)
    tiles = count_picture_tiles(width, height)
    program = ProgramKey("geometry", backend.schedule, records.dtype, settings)

    def integers(size: int) -> Tensor:
        return backend.memory.empty(size, dtype=torch.int32)

    order, spare_order, visible = integers(count), integers(count), integers(1)
    tile_counts = backend.memory.zeros(count if for_gradients else 0, dtype=torch.int32)
    first_slots = integers(count if for_gradients else 0)
    starts, places = integers(tiles + 1), integers(TILING_RUNS * tiles)
    run_totals = backend.memory.empty(TILING_RUNS + 1, dtype=torch.int64)
    with backend.session() as session:
        session.launch(program, "sort_by_depth", 1, count, radii, depth_keys, order, spare_order, visible)
        shared = (width, height, visible, order, records)
        session.launch(program, "count_tiles", TILING_RUNS, *shared, tile_counts, places, run_totals)
        session.launch(program, "place_tiles", 1, tiles, places, starts, run_totals)
        session.finish(run_totals)
        total = int(run_totals[TILING_RUNS])
        check_entries(total, width, height)
        entries, slots = integers(total), integers(total if for_gradients else 0)
        session.launch(
            program, "fill_tiles", TILING_RUNS if total else 0, *shared, places, run_totals, first_slots, entries, slots
        )
    return TileLists(starts, entries, slots, tile_counts, first_slots)
