"""The Haar wavelet transform of pictures. It is orthonormal: it preserves squared errors."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

BANDS = 4
"""Mean, horizontal, vertical and diagonal differences of each block of 2 x 2 pixels, in this order."""


def haar(pictures: Float[Tensor, "B C H W"]) -> Float[Tensor, "B 4*C H//2 W//2"]:
    """The means of all channels, then their horizontal, vertical and diagonal differences: signed sums of four, halved.

    Raises `ValueError` for odd sides. B = 0 is allowed.
    """
    height, width = pictures.shape[-2:]
    if height % 2 or width % 2:
        raise ValueError(f"a wavelet transform needs even sides, not {width} x {height}")
    top, bottom = pictures[..., 0::2, :], pictures[..., 1::2, :]
    a, b, c, d = top[..., 0::2], top[..., 1::2], bottom[..., 0::2], bottom[..., 1::2]
    return torch.cat([a + b + c + d, a - b + c - d, a + b - c - d, a - b - c + d], dim=1) / 2


def inverse_haar(coefficients: Float[Tensor, "B bands H W"]) -> Float[Tensor, "B bands//4 2*H 2*W"]:
    """The inverse of `haar`. Raises `ValueError` if the number of channels is not a multiple of four."""
    if coefficients.shape[1] % BANDS:
        raise ValueError(f"{coefficients.shape[1]} channels are not {BANDS} bands of equally many")
    mean, across, down, diagonal = coefficients.chunk(BANDS, dim=1)
    rows = [
        torch.stack([mean + across + down + diagonal, mean - across + down - diagonal], dim=-1).flatten(-2),
        torch.stack([mean + across - down - diagonal, mean - across - down + diagonal], dim=-1).flatten(-2),
    ]
    return torch.stack(rows, dim=-2).flatten(-3, -2) / 2
