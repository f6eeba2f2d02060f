"""Which Gaussians each tile of the picture draws, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import TILE, TILING_RUNS, ProgramKey

_LARGEST = 2**31 - 1


@dataclass(frozen=True)
class TileLists:
    """Entries of all tiles, tile by tile, each tile's by depth (equal depths by index)."""

    starts: Int[Tensor, " tiles_plus_1"]
    """Where each tile's entries start; the last is their number."""
    entries: Int[Tensor, " E"]
    """Each entry's Gaussian."""
    slots: Int[Tensor, " E"]
    """Each entry's place in an order in which every Gaussian's entries lie side by side."""
    tile_counts: Int[Tensor, " N"]
    """Entries of each Gaussian."""
    first_slots: Int[Tensor, " N"]
    """Its first slot; undefined where it has no entries."""

    @property
    def tiles(self) -> int:
        return len(self.starts) - 1


def sort_into_tiles(
    backend: Backend,
    settings: RasterSettings,
    width: int,
    height: int,
    records: Float[Tensor, "N 8"],
    radii: Int[Tensor, " N"],
    depth_keys: Int[Tensor, " N"],
) -> TileLists:
    """Lists for every tile; `RuntimeError` where they would hold more than 2^31 - 1 entries."""
    count = len(radii)
    tiles = -(-width // TILE) * -(-height // TILE)
    program = ProgramKey("geometry", backend.schedule, records.dtype, settings)

    def integers(size: int) -> Tensor:
        return backend.memory.empty(size, dtype=torch.int32)

    order, spare_order, visible = integers(count), integers(count), integers(1)
    tile_counts = backend.memory.zeros(count, dtype=torch.int32)
    first_slots, starts, places = integers(count), integers(tiles + 1), integers(TILING_RUNS * tiles)
    run_totals = backend.memory.empty(TILING_RUNS + 1, dtype=torch.int64)
    with backend.session() as session:
        session.launch(program, "sort_by_depth", 1, count, radii, depth_keys, order, spare_order, visible)
        shared = (width, height, visible, order, records)
        session.launch(program, "count_tiles", TILING_RUNS, *shared, tile_counts, places, run_totals)
        session.launch(program, "place_tiles", 1, tiles, places, starts, run_totals)
        session.finish(run_totals)
        total = int(run_totals[TILING_RUNS])
        if total > _LARGEST:
            raise RuntimeError(
                f"{total} pairs of a Gaussian and a tile, expected at most {_LARGEST}: the Gaussians are far too "
                f"large for a picture of {width} x {height} pixels"
            )
        entries, slots = integers(total), integers(total)
        session.launch(
            program, "fill_tiles", TILING_RUNS if total else 0, *shared, places, run_totals, first_slots, entries, slots
        )
    return TileLists(starts, entries, slots, tile_counts, first_slots)
