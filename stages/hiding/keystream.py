"""A stream cipher for real-valued vectors: without the key the output is uniform, whatever the input was.

A value is a direction in U dimensions and a length of at most 1. Each value gets a random rotation of its direction and
a random shift of its length around a circle. Both are drawn uniformly, so the output distribution does not depend on
the input. The random numbers are the output of SHAKE-256 for the key (the keystream), and secrecy rests on nobody
telling that output from random numbers. A key must encrypt one thing only: two things encrypted with the same key show
where they differ.

Rotations are drawn by the subgroup algorithm of Diaconis and Shahshahani (1987): a reflection that takes the first axis
to a uniformly drawn direction, after a rotation of the remaining axes that is drawn the same way. (The QR decomposition
of a normally distributed matrix would do as well, and takes ten times as long.)
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int
from scipy.special import ndtri
from torch import Tensor

SHORTEST, LONGEST = 0.3, 0.9
"""Encrypted lengths are uniform between these. Noise would turn the direction of a shorter one, and would push a longer
one out of the range that can be stored."""

MARGIN = 0.15
"""Unused share of the circle at either end; lengths from 0 to 1 fill the rest. Only noise beyond this makes a length of
1 decrypt as 0."""

BLOCK = 4096
"""Values per block of the keystream. In 8 dimensions a block takes 1.2 MB of random numbers."""

MOST_DIMENSIONS = 128
"""A block of so many takes 0.3 GB of random numbers, which grow with the square of the dimensions."""

Values = tuple[Float64[Tensor, "N U"], Float64[Tensor, " N"]]
"""Unit directions and lengths; the direction of a length of 0 is arbitrary."""


def encrypted(directions: Float64[Tensor, "N U"], lengths: Float64[Tensor, " N"], key: bytes) -> Values:
    """Encrypt N values, N = 0 allowed, U at least 1. Lengths in [0, 1] become lengths in [`SHORTEST`, `LONGEST`]."""
    turned, shifted = directions.clone(), torch.empty_like(lengths)
    turned[lengths == 0] = torch.eye(1, directions.shape[1], dtype=directions.dtype)  # such may have none
    for rows, stream in _keystreams(torch.arange(len(lengths)), directions.shape[1], key):
        turned[rows] = stream.turned(turned[rows])
        shifted[rows] = (MARGIN + (1 - 2 * MARGIN) * lengths[rows] + stream.shifts) % 1
    return turned, SHORTEST + (LONGEST - SHORTEST) * shifted


def decrypted(
    directions: Float64[Tensor, "K U"], lengths: Float64[Tensor, " K"], numbers: Int[Tensor, " K"], key: bytes
) -> Values:
    """Decrypt K values, K = 0 allowed; `numbers` are their positions when they were encrypted.

    Returned lengths are in [0, 1], whatever was done to the encrypted ones.
    """
    turned, shifted = torch.empty_like(directions), (lengths - SHORTEST) / (LONGEST - SHORTEST)
    for rows, stream in _keystreams(numbers, directions.shape[1], key):
        turned[rows] = stream.turned_back(directions[rows])
        shifted[rows] = (shifted[rows] - stream.shifts) % 1
    return turned, ((shifted - MARGIN) / (1 - 2 * MARGIN)).clamp(0, 1)


@dataclass(frozen=True)
class _Keystream:
    """For N values: unit vectors in U, U - 1, … 1 dimensions, which make the rotations, and shifts in (0, 1)."""

    axes: tuple[Float64[Tensor, "N _"], ...]
    shifts: Float64[Tensor, " N"]

    def turned(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, "N U"]:
        """Directions after their rotations. The reflection of the fewest axes comes first."""
        turned = directions.clone()
        for number in reversed(range(len(self.axes))):
            turned[:, number:] = _reflected(turned[:, number:], self.axes[number])
        return turned

    def turned_back(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, "N U"]:
        """The inverse of `turned`: every reflection is its own inverse, so they go in reverse order."""
        turned = directions.clone()
        for number, axes in enumerate(self.axes):
            turned[:, number:] = _reflected(turned[:, number:], axes)
        return turned


def _reflected(values: Float64[Tensor, "N V"], directions: Float64[Tensor, "N V"]) -> Float64[Tensor, "N V"]:
    """Values after the reflection that exchanges the first axis and a unit direction."""
    normal = directions.clone()
    normal[:, 0] -= 1
    square = normal.square().sum(dim=1, keepdim=True).clamp_min(torch.finfo(normal.dtype).tiny)
    return values - 2 * normal * (normal * values).sum(dim=1, keepdim=True) / square


def _keystreams(
    numbers: Int[Tensor, " N"], dimensions: int, key: bytes
) -> Iterator[tuple[Int[Tensor, " n"], _Keystream]]:
    """For each block: which rows of `numbers` are in it, and the keystream for them.

    A block is drawn up to the last value that is asked for: a shorter output of SHAKE-256 is the beginning of a longer
    one.
    """
    sizes = [dimensions - number for number in range(dimensions)]
    blocks, order = numbers.div(BLOCK, rounding_mode="floor").sort(stable=True)
    present, counts = blocks.unique_consecutive(return_counts=True)
    for block, rows in zip(present.tolist(), order.split(counts.tolist()), strict=True):
        places = (numbers[rows] - block * BLOCK).numpy()
        columns = 1 + sum(sizes)
        uniform = _uniform(key + block.to_bytes(8, "little"), (int(places.max()) + 1) * columns)
        own = uniform.reshape(-1, columns)[places]
        normal = torch.from_numpy(ndtri(own[:, 1:])).split(sizes, dim=1)
        axes = tuple(torch.nn.functional.normalize(each, dim=1) for each in normal)
        yield rows, _Keystream(axes, torch.from_numpy(own[:, 0]))


def _uniform(key: bytes, count: int) -> Float64[np.ndarray, " count"]:
    """Uniform numbers in the open interval (0, 1)."""
    data = hashlib.shake_256(key).digest(8 * count)
    return ((np.frombuffer(data, "<u8") >> np.uint64(12)) + 0.5) / 2**52
