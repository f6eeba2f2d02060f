"""One-time pads: what comes out is as likely whatever went in, and says nothing of it to who has not the key.

Here a value is a direction in U dimensions and a length of at most 1. A rotation that is drawn evenly, for each value
by itself, makes of its direction any other as likely; a shift around a circle does so with its length. Which they are
follows from SHAKE-256 of the key, whose numbers nobody can tell from random ones. A key may serve once: by two things
enciphered with one it would be seen what they differ in.

A rotation is drawn as by Diaconis and Shahshahani (1987): a reflection that takes the first axis to a direction drawn
evenly, after a rotation, drawn so, of the axes that remain.
"""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from jaxtyping import Float64, Int
from scipy.special import ndtri
from torch import Tensor

SHORTEST, LONGEST = 0.3, 0.98
"""Between which the lengths that come out lie, evenly: of a short one noise would turn the direction."""

MARGIN = 0.15
"""At either end of the circle, on which lengths from 0 to 1 have the rest: so far may noise take one of 1 before it
comes out as 0."""

Values = tuple[Float64[Tensor, "N U"], Float64[Tensor, " N"]]
"""Unit directions and lengths; of a length of 0 any direction."""


def enciphered(directions: Float64[Tensor, "N U"], lengths: Float64[Tensor, " N"], key: bytes) -> Values:
    """Of N values, N = 0 is allowed, U at least 1; lengths from 0 to 1 become such from `SHORTEST` to `LONGEST`."""
    axes, shifts = _drawn(torch.arange(len(lengths)), directions.shape[1], key)
    turned = directions.clone()
    turned[lengths == 0, 0] += 1  # such may have none
    turned = torch.nn.functional.normalize(turned, dim=1)
    for number in reversed(range(len(axes))):
        turned[:, number:] = _reflected(turned[:, number:], axes[number])
    shifted = (MARGIN + (1 - 2 * MARGIN) * lengths + shifts) % 1
    return turned, SHORTEST + (LONGEST - SHORTEST) * shifted


def deciphered(
    directions: Float64[Tensor, "K U"], lengths: Float64[Tensor, " K"], numbers: Int[Tensor, " K"], key: bytes
) -> Values:
    """Of K values, which were those of these numbers when they were enciphered; K = 0 is allowed.

    Whatever was done to lengths, from 0 to 1 is what comes out.
    """
    axes, shifts = _drawn(numbers, directions.shape[1], key)
    turned = directions.clone()
    for number in range(len(axes)):
        turned[:, number:] = _reflected(turned[:, number:], axes[number])
    shifted = ((lengths - SHORTEST) / (LONGEST - SHORTEST) - shifts) % 1
    return turned, ((shifted - MARGIN) / (1 - 2 * MARGIN)).clamp(0, 1)


def _reflected(values: Float64[Tensor, "N V"], directions: Float64[Tensor, "N V"]) -> Float64[Tensor, "N V"]:
    """By the reflection that exchanges the first axis and a unit direction."""
    normal = directions.clone()
    normal[:, 0] -= 1
    square = normal.square().sum(dim=1, keepdim=True).clamp_min(torch.finfo(normal.dtype).tiny)
    return values - 2 * normal * (normal * values).sum(dim=1, keepdim=True) / square


def _drawn(
    numbers: Int[Tensor, " N"], dimensions: int, key: bytes
) -> tuple[list[Float64[Tensor, "N V"]], Float64[Tensor, " N"]]:
    """Directions in `dimensions`, one fewer, and so on to one, and shifts from 0 to 1, for values by their numbers."""
    sizes = [dimensions - number for number in range(dimensions)]
    count = 1 + int(numbers.max()) if len(numbers) else 0
    stream = hashlib.shake_256(key).digest(8 * count * (1 + sum(sizes)))
    uniform = ((np.frombuffer(stream, "<u8") >> np.uint64(12)) + 0.5) / 2**52  # neither 0 nor 1
    shifts, normal = torch.from_numpy(uniform).view(count, 1 + sum(sizes))[numbers].split([1, sum(sizes)], dim=1)
    axes = torch.from_numpy(ndtri(normal.numpy())).split(sizes, dim=1)
    return [torch.nn.functional.normalize(each, dim=1) for each in axes], shifts[:, 0]
