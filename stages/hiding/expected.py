"""What the owner expects of a Gaussian's feature, given its share of the cover, before looking at the feature.

A Gaussian that belongs to the cover hardly belongs to a message, so the message decoder reads next to nothing from it.
Sealing only needs to encrypt a feature's difference from the expectation: the smaller it is, the less noise can harm.
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
"""Expectations are tabulated at up to 16 cover shares (knots), one per 250 Gaussians, at multiples of 1e-3, and
interpolated linearly between them. On the fox, 8 knots would do about as well. If knots were closer to each other,
rounding a share would change what is expected."""

SMALLEST = 1e-4
"""Lower bound on tabulated distances, so that nothing is divided by 0 before logarithms are taken."""

LARGEST = 1e6
"""Upper bound on readings and distances. For features in [0, 1] both are a few at most; far larger ones would
overflow."""

FACTS = ("expected_cover_shares", "expected_readings", "usual_distances", "farthest_distances")
"""Their names among a secret's facts; readings are flattened row by row."""


@dataclass(frozen=True)
class Expected:
    """For K ascending cover shares, the expected readings of centred features along the message decoder's Q rows.

    `usual` and `farthest` are the median and the largest distance of the Gaussians around each share from the features
    that give the expected readings.
    """

    cover_shares: Float64[np.ndarray, " K"]
    readings: Float64[np.ndarray, "K Q"]
    usual: Float64[np.ndarray, " K"]
    farthest: Float64[np.ndarray, " K"]

    def readings_at(self, cover_shares: Float64[Tensor, " N"]) -> Float64[Tensor, "N Q"]:
        """The expected readings of N Gaussians, interpolated; constant beyond the first and the last share."""
        return torch.stack([self._at(cover_shares, column) for column in self.readings.T], dim=1)

    def lengths(self, cover_shares: Float64[Tensor, " N"], distances: Float64[Tensor, " N"]) -> Float64[Tensor, " N"]:
        """Map distances up to the farthest to [0, 1], logarithmically, so that usual distances are not all close to 0.

        Noise changes every length by the same amount. With lengths proportional to distances, bonsai's message would
        have 19.9 dB instead of 20.5 at the noise that costs the cover 0.2 dB.
        """
        usual, farthest = (self._at(cover_shares, values) for values in (self.usual, self.farthest))
        return torch.log1p(distances / usual) / torch.log1p(farthest / usual)

    def distances(self, cover_shares: Float64[Tensor, " N"], lengths: Float64[Tensor, " N"]) -> Float64[Tensor, " N"]:
        """The inverse of `lengths`."""
        usual, farthest = (self._at(cover_shares, values) for values in (self.usual, self.farthest))
        return usual * torch.expm1(lengths * torch.log1p(farthest / usual))

    def _at(self, cover_shares: Float64[Tensor, " N"], values: Float64[np.ndarray, " K"]) -> Float64[Tensor, " N"]:
        return torch.from_numpy(np.interp(cover_shares.numpy(), self.cover_shares, values))

    def facts(self) -> dict[str, Json]:
        """Return these expectations as facts of a secret, from which `from_facts` restores them exactly."""
        values = (self.cover_shares, self.readings, self.usual, self.farthest)
        return {name: each.ravel().tolist() for name, each in zip(FACTS, values, strict=True)}

    @classmethod
    def from_facts(cls, facts: Mapping[str, object], rows: int) -> Expected:
        """Restore expectations for a message decoder with `rows` rows. Raises `ValueError` for invalid facts."""
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
            raise ValueError("expected shares of the cover that do not increase, or invalid distances")
        if np.abs(np.concatenate([readings, farthest])).max() > LARGEST:
            raise ValueError(f"expectations beyond {LARGEST:g}")
        return cls(shares, readings.reshape(len(shares), rows), usual, farthest)


def expectations(
    cover_shares: Float64[Tensor, " N"],
    readings: Float64[Tensor, "N Q"],
    distances_from: Callable[[Expected], Float64[Tensor, " N"]],
) -> Expected:
    """The expectations of N Gaussians, N = 0 allowed. No Gaussian is farther from its expectation than `farthest` says.

    `distances_from` gives the Gaussians' distances from the features that give the expected readings.
    """
    knots = _knots(cover_shares)
    nearest = np.searchsorted((knots[1:] + knots[:-1]) / 2, cover_shares.numpy())
    ones = np.ones(len(knots))
    expected = Expected(knots, _means(readings, nearest, len(knots)), ones, ones)
    distances = distances_from(expected).numpy()
    usual = [np.median(distances[nearest == knot]) if (nearest == knot).any() else 0.0 for knot in range(len(knots))]
    upper = np.searchsorted(knots, cover_shares.numpy()).clip(0, len(knots) - 1)
    farthest = np.maximum(usual, SMALLEST)
    for beside in (upper, (upper - 1).clip(0)):  # so that interpolated values bound the distances, too
        np.maximum.at(farthest, beside, distances)
    return replace(expected, usual=np.maximum(usual, SMALLEST), farthest=farthest)


def _knots(cover_shares: Float64[Tensor, " N"]) -> Float64[np.ndarray, " K"]:
    """Cover shares that separate groups of about equally many Gaussians, ascending; a single 0 without Gaussians."""
    if not len(cover_shares):
        return np.zeros(1)
    wanted = np.linspace(0, 1, max(1, min(KNOTS, len(cover_shares) // FOR_A_KNOT)))
    return APART * np.unique(np.round(np.quantile(cover_shares.numpy(), wanted, method="nearest") / APART))


def _means(readings: Float64[Tensor, "N Q"], nearest: Int[np.ndarray, " N"], knots: int) -> Float64[np.ndarray, "K Q"]:
    """The mean readings of the Gaussians nearest to each knot; zeros if there are none."""
    sums = np.zeros((knots, readings.shape[1]))
    np.add.at(sums, nearest, readings.numpy())
    return sums / np.maximum(1, np.bincount(nearest, minlength=knots))[:, None]
