"""What the owner of a container expects of a Gaussian by how much of it is the cover's, before he has looked at it.

One that is the cover's is hardly a message's, and of what the message decoder reads there is next to nothing in it.
What is sealed need only be by how much it differs from that, and the smaller that is, the less noise can do to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from pipeline.artifact import Json

KNOTS, FOR_A_KNOT, APART = 16, 250, 1e-3
"""Shares of the cover at most for which expectations are kept, Gaussians for each at least, and how far they are apart;
between them they go over into each other. On the fox 8 would do about as well. Nearer to each other, what rounding does
to a share would change what is expected."""

FACTS = ("expected_cover_shares", "expected_readings", "expected_reaches")
"""What they are called among a secret's facts; readings one row after the other."""


@dataclass(frozen=True)
class Expected:
    """For K ascending shares of the cover what the message decoder reads along its Q rows, and how far off it may be.

    `readings` of centred features; `reaches` in their units, as far as the farthest of those Gaussians.
    """

    cover_shares: Float64[np.ndarray, " K"]
    readings: Float64[np.ndarray, "K Q"]
    reaches: Float64[np.ndarray, " K"]

    def readings_at(self, cover_shares: Float64[Tensor, " N"]) -> Float64[Tensor, "N Q"]:
        """For any N Gaussians; beyond the first and the last share they are those of these."""
        at = [np.interp(cover_shares.numpy(), self.cover_shares, column) for column in self.readings.T]
        return torch.from_numpy(np.stack(at, axis=1))

    def reaches_at(self, cover_shares: Float64[Tensor, " N"]) -> Float64[Tensor, " N"]:
        """For any N Gaussians."""
        return torch.from_numpy(np.interp(cover_shares.numpy(), self.cover_shares, self.reaches))

    def facts(self) -> dict[str, Json]:
        """As facts of a secret, from which `from_facts` makes the same again."""
        values = (self.cover_shares, self.readings, self.reaches)
        return {name: each.ravel().tolist() for name, each in zip(FACTS, values, strict=True)}

    @classmethod
    def from_facts(cls, facts: Mapping[str, object], rows: int) -> Expected:
        """For a message decoder that reads along `rows`. Raises ValueError for facts that are none of these."""
        try:
            shares, readings, reaches = (np.array(facts[name], dtype=np.float64).ravel() for name in FACTS)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"not {', '.join(FACTS)} in numbers") from error
        if not len(shares) == len(reaches) > 0 or len(readings) != rows * len(shares):
            raise ValueError(f"{len(shares)}, {len(readings)} and {len(reaches)} expectations, by {rows} rows")
        if not all(np.isfinite(each).all() for each in (shares, readings, reaches)):
            raise ValueError("expectations that are not finite")
        if (np.diff(shares) <= 0).any() or (reaches <= 0).any():
            raise ValueError("expected shares of the cover that do not ascend, or reaches that are not above 0")
        return cls(shares, readings.reshape(len(shares), rows), reaches)


def knots_of(cover_shares: Float64[Tensor, " N"]) -> Float64[np.ndarray, " K"]:
    """Shares that about as many Gaussians lie between, in ascending order; one of 0 where there are no Gaussians."""
    if not len(cover_shares):
        return np.zeros(1)
    wanted = np.linspace(0, 1, max(1, min(KNOTS, len(cover_shares) // FOR_A_KNOT)))
    return APART * np.unique(np.round(np.quantile(cover_shares.numpy(), wanted, method="nearest") / APART))


def readings_of(
    cover_shares: Float64[Tensor, " N"], readings: Float64[Tensor, "N Q"], knots: Float64[np.ndarray, " K"]
) -> Float64[np.ndarray, "K Q"]:
    """Of the Gaussians nearest to each knot the mean; zeros where there are none."""
    nearest = np.searchsorted((knots[1:] + knots[:-1]) / 2, cover_shares.numpy())
    means = np.zeros((len(knots), readings.shape[1]))
    np.add.at(means, nearest, readings.numpy())
    return means / np.maximum(1, np.bincount(nearest, minlength=len(knots)))[:, None]


def reaches_of(
    cover_shares: Float64[Tensor, " N"], distances: Float64[Tensor, " N"], knots: Float64[np.ndarray, " K"]
) -> Float64[np.ndarray, " K"]:
    """The farthest between a knot and its neighbours, so that none is farther than what is between two knots."""
    upper = np.searchsorted(knots, cover_shares.numpy()).clip(0, len(knots) - 1)
    reaches = np.full(len(knots), np.finfo(np.float32).eps, dtype=np.float64)
    for beside in (upper, (upper - 1).clip(0)):
        np.maximum.at(reaches, beside, distances.numpy())
    return reaches
