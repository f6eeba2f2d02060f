"""Tile lists on the GPU schedule: Gaussians are sorted by depth, then their (tile, Gaussian) pairs by tile."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from opencl.backend import Backend, Session
from opencl.contract import RasterSettings
from opencl.program import GROUP_SIZE, ProgramKey
from opencl.radix_sort import scan, sort_by_keys
from opencl.tile_lists import TileLists, check_entries, count_picture_tiles


def sort_into_tiles_on_gpu(
    backend: Backend,
    settings: RasterSettings,
    width: int,
    height: int,
    records: Float[Tensor, "N 8"],
    radii: Int[Tensor, " N"],
    depth_keys: Int[Tensor, " N"],
    for_gradients: bool,
) -> TileLists:
    """See `opencl.tiling.sort_into_tiles`. Slots are sorted by depth of the Gaussian, then by tile."""
    count, tiles = len(radii), count_picture_tiles(width, height)
    program = ProgramKey("geometry", backend.schedule, records.dtype, settings)
    with backend.session() as session:
        tile_counts, first_slots = _integers(session, count), _integers(session, count)
        order = _sort_by_depth(session, program, radii, depth_keys)
        slot_starts = session.memory.empty(count, dtype=torch.int64)
        outputs = (tile_counts, slot_starts)
        _launch(session, program, "count_tiles", count, count, width, height, radii, order, records, *outputs)
        all_slots = scan(session, program, slot_starts)
        session.finish(all_slots)
        total = int(all_slots)
        check_entries(total, width, height)
        gaussians, slots, entries = (_integers(session, total) for _ in range(3))
        starts, tiles_of_slots = _integers(session, tiles + 1), session.memory.empty(total, dtype=depth_keys.dtype)
        _launch(
            *(session, program, "fill_slots", total, total, count, width, height),
            *(order, slot_starts, records, tile_counts, first_slots, gaussians, tiles_of_slots, slots),
        )
        sorted_tiles, slots = _sort_by_tile(session, program, tiles, tiles_of_slots, slots)
        _launch(session, program, "start_tiles", tiles + 1, tiles, total, sorted_tiles, starts)
        _launch(session, program, "fill_entries", total, total, gaussians, slots, entries)
    if not for_gradients:
        slots, tile_counts, first_slots = slots[:0], tile_counts[:0], first_slots[:0]
    return TileLists(starts, entries, slots, tile_counts, first_slots)


def _integers(session: Session, size: int) -> Tensor:
    return session.memory.empty(size, dtype=torch.int32)


def _launch(session: Session, program: ProgramKey, kernel: str, work_items: int, *arguments: Tensor | int) -> None:
    """Launch a kernel with at least `work_items` work-items, in whole groups."""
    group_size = GROUP_SIZE[program.schedule]
    session.launch(program, kernel, -(-work_items // group_size), *arguments, group_size=group_size)


def _sort_by_depth(
    session: Session, program: ProgramKey, radii: Int[Tensor, " N"], depth_keys: Int[Tensor, " N"]
) -> Int[Tensor, " N"]:
    """Indices of Gaussians sorted by depth, then by index, with invisible ones last."""
    keys, order = session.memory.empty(len(radii), dtype=depth_keys.dtype), _integers(session, len(radii))
    _launch(session, program, "key_by_depth", len(radii), len(radii), radii, depth_keys, keys, order)
    if session.torch_is_in_order:  # the same order in one call; ours takes 24 launches or more
        return keys.sort(stable=True).indices.to(torch.int32)
    return sort_by_keys(session, program, 8 * depth_keys.element_size(), keys, order)[1]


def _sort_by_tile(
    session: Session, program: ProgramKey, tiles: int, tiles_of_slots: Int[Tensor, " E"], slots: Int[Tensor, " E"]
) -> tuple[Int[Tensor, " E"], Int[Tensor, " E"]]:
    """Stable sort of slots by tile. Returns tiles and slots; slots without a tile have the number `tiles`, the last."""
    if session.torch_is_in_order:  # the same in one call; ours takes 3 launches or more for each digit
        sorted_tiles, order = tiles_of_slots.sort(stable=True)
        return sorted_tiles, order.to(torch.int32)
    return sort_by_keys(session, program, tiles.bit_length(), tiles_of_slots, slots)
