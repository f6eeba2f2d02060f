"""The lists of Gaussians that tiles draw, whichever schedule makes them."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Int
from torch import Tensor

from opencl.program import TILE

_LARGEST = 2**31 - 1


@dataclass(frozen=True)
class TileLists:
    """Entries of all tiles, tile by tile, each tile's by depth (equal depths by index)."""

    starts: Int[Tensor, " tiles_plus_1"]
    """Where each tile's entries start; the last is their number. Entries beyond it belong to no tile."""
    entries: Int[Tensor, " E"]
    """Each entry's Gaussian."""
    slots: Int[Tensor, " E"]
    """Each entry's place in an order in which every Gaussian's entries lie side by side."""
    tile_counts: Int[Tensor, " N"]
    """Entries of each Gaussian."""
    first_slots: Int[Tensor, " N"]
    """Its first slot; undefined where it has no entries. Slots serve gradients; without those the three are empty."""

    @property
    def tiles(self) -> int:
        return len(self.starts) - 1


def count_picture_tiles(width: int, height: int) -> int:
    """Tiles of a picture; those at its right and lower borders may reach beyond."""
    return -(-width // TILE) * -(-height // TILE)


def check_entries(total: int, width: int, height: int) -> None:
    """`RuntimeError` where the lists of a picture would hold more entries than can be numbered."""
    if total > _LARGEST:
        raise RuntimeError(
            f"{total} pairs of a Gaussian and a tile, expected at most {_LARGEST}: the Gaussians are far too "
            f"large for a picture of {width} x {height} pixels"
        )
