"""Counts of pairs of neighbouring values, in the classes of Dumitrescu's two detectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


class PairCounts(NamedTuple):
    """Counts of pairs (u, v), with the papers' names: all `pairs` (P); `rising` (X), with v even and u < v, or v odd
    and u > v; `falling` (Y), with v even and u > v, or v odd and u < v; `equal` (Z), with u = v; and `within` (W), a
    subset of Y (see `count_pairs`).
    """

    pairs: int
    rising: int
    falling: int
    equal: int
    within: int

    def __add__(self, other: tuple[int, ...]) -> PairCounts:  # type: ignore[override]  # not the concatenation
        return PairCounts(*(own + more for own, more in zip(self, other, strict=True)))

    @property
    def quadratic(self) -> tuple[float, float, float]:
        """(a, b, c) = ((W + Z) / 2, 2 X − P, Y − X): the share of changed bits is a root of a x² + b x + c."""
        return 0.5 * (self.within + self.equal), 2.0 * self.rising - self.pairs, float(self.falling - self.rising)


def count_pairs(u: UInt8[np.ndarray, "A B"], v: UInt8[np.ndarray, "A B"], slip: bool = False) -> PairCounts:
    """The counts of the pairs (u, v) at equal positions, of which there may be none.

    W counts pairs that differ only in their lowest bit. With `slip`, it reproduces a slip in StegExpose's primary sets,
    on which its published figures depend: W then counts those pairs of Y in which u or v is odd.
    """
    odd = (v & 1).astype(bool)
    less, equal = u < v, u == v
    falling = (less == odd) & ~equal
    within = falling & ((u | v) & 1).astype(bool) if slip else (u ^ v) == 1
    of_falling, of_equal, of_within = (int(np.count_nonzero(chosen)) for chosen in (falling, equal, within))
    return PairCounts(u.size, u.size - of_falling - of_equal, of_falling, of_equal, of_within)
