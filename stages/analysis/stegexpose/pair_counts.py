"""Pairs of neighbouring values, sorted as Dumitrescu's two detectors need them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


class PairCounts(NamedTuple):
    """Of `pairs` (u, v), P: `rising` (X) have v even and u < v, or v odd and u > v; `falling` (Y) have v even, u > v,
    or v odd, u < v; `equal` (Z) have u = v; `within` (W) are those of Y that a detector counts so.
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
        """a = (W + Z) / 2, b = 2 X − P and c = Y − X: the share of changed bits is a root of a x² + b x + c."""
        return 0.5 * (self.within + self.equal), 2.0 * self.rising - self.pairs, float(self.falling - self.rising)


def count_pairs(u: UInt8[np.ndarray, "A B"], v: UInt8[np.ndarray, "A B"], slip: bool = False) -> PairCounts:
    """The counts of the pairs (u, v) at the same places; any number of pairs, none as well.

    W: pairs that differ in their lowest bit alone. With the `slip` of StegExpose's primary sets, instead, of Y those
    with u even and v odd, or u odd, whatever v: its figures carry that.
    """
    odd = (v & 1).astype(bool)
    less, equal = u < v, u == v
    falling = (less == odd) & ~equal
    within = falling & ((u | v) & 1).astype(bool) if slip else (u ^ v) == 1
    of_falling, of_equal, of_within = (int(np.count_nonzero(chosen)) for chosen in (falling, equal, within))
    return PairCounts(u.size, u.size - of_falling - of_equal, of_falling, of_equal, of_within)
