"""One-time pads: what comes out is as likely whatever went in, and says nothing of it to who has not the key.

Here a value is a direction in U dimensions and a length of at most 1. A rotation that is drawn evenly, for each value
by itself, makes of its direction any other as likely; a shift around a circle does so with its length. Which they are
follows from SHAKE-256 of the key, whose numbers nobody can tell from random ones. A key may serve once: by two things
enciphered with one it would be seen what they differ in.

A rotation is drawn as by Diaconis and Shahshahani (1987): a reflection that takes the first axis to a direction drawn
evenly, after a rotation, drawn so, of the axes that remain. (Orthogonal matrices of normally distributed numbers would
do as well, and take ten times as long.)
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
"""Between which the lengths that come out lie, evenly: of a short one noise would turn the direction, and a long one it
would take out of what can be stored."""

MARGIN = 0.15
"""At either end of the circle, on which lengths from 0 to 1 have the rest: so far may noise take one of 1 before it
comes out as 0."""

BLOCK = 4096
"""Values whose pads are drawn at a time, of 8 dimensions by 1.2 MB of random numbers."""

Values = tuple[Float64[Tensor, "N U"], Float64[Tensor, " N"]]
"""Unit directions and lengths; of a length of 0 any direction."""


def enciphered(directions: Float64[Tensor, "N U"], lengths: Float64[Tensor, " N"], key: bytes) -> Values:
    """Of N values, N = 0 is allowed, U at least 1; lengths from 0 to 1 become such from `SHORTEST` to `LONGEST`."""
    turned, shifted = directions.clone(), torch.empty_like(lengths)
    turned[lengths == 0] = torch.eye(1, directions.shape[1], dtype=directions.dtype)  # such may have none
    for rows, pad in _pads(torch.arange(len(lengths)), directions.shape[1], key):
        turned[rows] = pad.turned(turned[rows])
        shifted[rows] = (MARGIN + (1 - 2 * MARGIN) * lengths[rows] + pad.shifts) % 1
    return turned, SHORTEST + (LONGEST - SHORTEST) * shifted


def deciphered(
    directions: Float64[Tensor, "K U"], lengths: Float64[Tensor, " K"], numbers: Int[Tensor, " K"], key: bytes
) -> Values:
    """Of K values, which were those of these numbers when they were enciphered; K = 0 is allowed.

    Whatever was done to lengths, from 0 to 1 is what comes out.
    """
    turned, shifted = torch.empty_like(directions), (lengths - SHORTEST) / (LONGEST - SHORTEST)
    for rows, pad in _pads(numbers, directions.shape[1], key):
        turned[rows] = pad.turned_back(directions[rows])
        shifted[rows] = (shifted[rows] - pad.shifts) % 1
    return turned, ((shifted - MARGIN) / (1 - 2 * MARGIN)).clamp(0, 1)


@dataclass(frozen=True)
class _Pad:
    """Of N values: unit directions in U dimensions, in one fewer, and so on to one, and shifts between 0 and 1."""

    axes: tuple[Float64[Tensor, "N V"], ...]
    shifts: Float64[Tensor, " N"]

    def turned(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, "N U"]:
        """Of the axes that remain first."""
        turned = directions.clone()
        for number in reversed(range(len(self.axes))):
            turned[:, number:] = _reflected(turned[:, number:], self.axes[number])
        return turned

    def turned_back(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, "N U"]:
        """The other way round: each reflection undoes itself."""
        turned = directions.clone()
        for number, axes in enumerate(self.axes):
            turned[:, number:] = _reflected(turned[:, number:], axes)
        return turned


def _reflected(values: Float64[Tensor, "N V"], directions: Float64[Tensor, "N V"]) -> Float64[Tensor, "N V"]:
    """By the reflection that exchanges the first axis and a unit direction."""
    normal = directions.clone()
    normal[:, 0] -= 1
    square = normal.square().sum(dim=1, keepdim=True).clamp_min(torch.finfo(normal.dtype).tiny)
    return values - 2 * normal * (normal * values).sum(dim=1, keepdim=True) / square


def _pads(numbers: Int[Tensor, " N"], dimensions: int, key: bytes) -> Iterator[tuple[Int[Tensor, " n"], _Pad]]:
    """Block by block the rows of `numbers` that are in it, and their pads."""
    sizes = [dimensions - number for number in range(dimensions)]
    blocks = numbers.div(BLOCK, rounding_mode="floor")
    for block in blocks.unique().tolist():
        [rows] = torch.nonzero(blocks == block, as_tuple=True)
        uniform = _uniform(key + block.to_bytes(8, "little"), BLOCK * (1 + sum(sizes))).reshape(BLOCK, -1)
        own = uniform[(numbers[rows] - block * BLOCK).numpy()]
        normal = torch.from_numpy(ndtri(own[:, 1:])).split(sizes, dim=1)
        axes = tuple(torch.nn.functional.normalize(each, dim=1) for each in normal)
        yield rows, _Pad(axes, torch.from_numpy(own[:, 0]))


def _uniform(key: bytes, count: int) -> Float64[np.ndarray, " count"]:
    """Numbers between 0 and 1, neither of which is drawn."""
    stream = hashlib.shake_256(key).digest(8 * count)
    return ((np.frombuffer(stream, "<u8") >> np.uint64(12)) + 0.5) / 2**52
