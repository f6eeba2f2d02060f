"""What the owner of a container expects of a Gaussian by how much of it is the cover's, before he has looked at it.

One that is the cover's is hardly a message's, and of what the message decoder reads there is next to nothing in it.
What is sealed need only be by how much it differs from that, and the smaller that is, the less noise can do to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, Int
from torch import Tensor

from pipeline.artifact import Json

KNOTS, FOR_A_KNOT, APART = 16, 250, 1e-3
"""Shares of the cover at most for which expectations are kept, Gaussians for each at least, and how far they are apart;
between them they go over into each other. On the fox 8 would do about as well. Nearer to each other, what rounding does
to a share would change what is expected."""

SMALLEST = 1e-4
"""Distance that is told from none: of logarithms those of nothing are not taken."""

LARGEST = 1e6
"""Reading or distance: of features in [0, 1] both are a few at most, and far larger ones make no numbers of them."""

FACTS = ("expected_cover_shares", "expected_readings", "usual_distances", "farthest_distances")
"""What they are called among a secret's facts; readings one row after the other."""


@dataclass(frozen=True)
class Expected:
    """For K ascending shares of the cover what the message decoder reads along its Q rows, of centred features.

    `usual` and `farthest` are distances of those Gaussians from where it reads that: the median, and the largest.
    """

    cover_shares: Float64[np.ndarray, " K"]
    readings: Float64[np.ndarray, "K Q"]
    usual: Float64[np.ndarray, " K"]
    farthest: Float64[np.ndarray, " K"]

    def readings_at(self, cover_shares: Float64[Tensor, " N"]) -> Float64[Tensor, "N Q"]:
        """For any N Gaussians; beyond the first and the last share they are those of these."""
        return torch.stack([self._at(cover_shares, column) for column in self.readings.T], dim=1)

    def lengths(self, cover_shares: Float64[Tensor, " N"], distances: Float64[Tensor, " N"]) -> Float64[Tensor, " N"]:
        """From 0 to 1, of distances up to the farthest: their logarithms, so that usual ones are not all next to 0.

        Noise changes lengths by as much everywhere. Were they the distances themselves, bonsai's message would have
        19.9 dB instead of 20.5 where noise costs the cover 0.2.
        """
        usual, farthest = (self._at(cover_shares, values) for values in (self.usual, self.farthest))
        return torch.log1p(distances / usual) / torch.log1p(farthest / usual)

    def distances(self, cover_shares: Float64[Tensor, " N"], lengths: Float64[Tensor, " N"]) -> Float64[Tensor, " N"]:
        """Those of which `lengths` makes these."""
        usual, farthest = (self._at(cover_shares, values) for values in (self.usual, self.farthest))
        return usual * torch.expm1(lengths * torch.log1p(farthest / usual))

    def _at(self, cover_shares: Float64[Tensor, " N"], values: Float64[np.ndarray, " K"]) -> Float64[Tensor, " N"]:
        return torch.from_numpy(np.interp(cover_shares.numpy(), self.cover_shares, values))

    def facts(self) -> dict[str, Json]:
        """As facts of a secret, from which `from_facts` makes the same again."""
        values = (self.cover_shares, self.readings, self.usual, self.farthest)
        return {name: each.ravel().tolist() for name, each in zip(FACTS, values, strict=True)}

    @classmethod
    def from_facts(cls, facts: Mapping[str, object], rows: int) -> Expected:
        """For a message decoder that reads along `rows`. Raises ValueError for facts that are none of these."""
        try:
            shares, readings, usual, farthest = (np.array(facts[name], dtype=np.float64).ravel() for name in FACTS)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"not {', '.join(FACTS)} in numbers") from error
        counts = (len(shares), len(readings), len(usual), len(farthest))
        if not shares.size or counts != (len(shares), rows * len(shares), len(shares), len(shares)):
            raise ValueError(f"{counts} expectations, by {rows} rows")
        if not all(np.isfinite(each).all() for each in (shares, readings, usual, farthest)):
            raise ValueError("expectations that are not finite")
        if (np.diff(shares) <= 0).any() or (usual < SMALLEST).any() or (farthest < usual).any():
            raise ValueError("expected shares of the cover that do not ascend, or distances that are none")
        if np.abs(np.concatenate([readings, farthest])).max() > LARGEST:
            raise ValueError(f"expectations beyond {LARGEST:g}")
        return cls(shares, readings.reshape(len(shares), rows), usual, farthest)


def expectations(
    cover_shares: Float64[Tensor, " N"],
    readings: Float64[Tensor, "N Q"],
    distances_from: Callable[[Expected], Float64[Tensor, " N"]],
) -> Expected:
    """What of N Gaussians is to be expected, none of which is farther off than that.

    `distances_from`: how far they are from where the message decoder reads what is expected.
    """
    knots = _knots(cover_shares)
    nearest = np.searchsorted((knots[1:] + knots[:-1]) / 2, cover_shares.numpy())
    ones = np.ones(len(knots))
    expected = Expected(knots, _means(readings, nearest, len(knots)), ones, ones)
    distances = distances_from(expected).numpy()
    usual = [np.median(distances[nearest == knot]) if (nearest == knot).any() else 0.0 for knot in range(len(knots))]
    upper = np.searchsorted(knots, cover_shares.numpy()).clip(0, len(knots) - 1)
    farthest = np.maximum(usual, SMALLEST)
    for beside in (upper, (upper - 1).clip(0)):  # none is farther off than what is between two knots
        np.maximum.at(farthest, beside, distances)
    return replace(expected, usual=np.maximum(usual, SMALLEST), farthest=farthest)


def _knots(cover_shares: Float64[Tensor, " N"]) -> Float64[np.ndarray, " K"]:
    """Shares that about as many Gaussians lie between, in ascending order; one of 0 where there are no Gaussians."""
    if not len(cover_shares):
        return np.zeros(1)
    wanted = np.linspace(0, 1, max(1, min(KNOTS, len(cover_shares) // FOR_A_KNOT)))
    return APART * np.unique(np.round(np.quantile(cover_shares.numpy(), wanted, method="nearest") / APART))


def _means(readings: Float64[Tensor, "N Q"], nearest: Int[np.ndarray, " N"], knots: int) -> Float64[np.ndarray, "K Q"]:
    """Of the Gaussians nearest to each knot; zeros where there are none."""
    sums = np.zeros((knots, readings.shape[1]))
    np.add.at(sums, nearest, readings.numpy())
    return sums / np.maximum(1, np.bincount(nearest, minlength=knots))[:, None]
