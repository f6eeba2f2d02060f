"""Lists of the Gaussians that each tile draws, common to both schedules."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Int
from torch import Tensor

from opencl.program import TILE

_LARGEST = 2**31 - 1


@dataclass(frozen=True)
class TileLists:
    """The (tile, Gaussian) pairs of a picture, sorted by tile, then depth, then index of the Gaussian."""

    starts: Int[Tensor, " tiles_plus_1"]
    """Start of each tile's entries, followed by their total number. Entries beyond that belong to no tile."""
    entries: Int[Tensor, " E"]
    """The Gaussian of each entry."""
    slots: Int[Tensor, " slots"]
    """Position of each entry in an order in which the entries of a Gaussian are consecutive."""
    tile_counts: Int[Tensor, " counted"]
    """Number of entries of each Gaussian."""
    first_slots: Int[Tensor, " counted"]
    """First slot of each Gaussian, undefined without entries. Empty, like the two above, if not for gradients."""

    @property
    def tiles(self) -> int:
        return len(self.starts) - 1


def count_picture_tiles(width: int, height: int) -> int:
    """Number of tiles of a picture. Tiles at the right and lower borders may extend beyond it."""
    return -(-width // TILE) * -(-height // TILE)


def check_entries(total: int, width: int, height: int) -> None:
    """Raise RuntimeError if a picture's lists would have more than 2^31 - 1 entries, the most that int32 can index."""
    if total > _LARGEST:
        raise RuntimeError(
            f"{total} pairs of a Gaussian and a tile, expected at most {_LARGEST}: the Gaussians are far too "
            f"large for a picture of {width} x {height} pixels"
        )
