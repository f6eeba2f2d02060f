"""A mipmap of texture pages, sampled with a blur that matches the pixel's footprint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Int32

SMALLEST_PAGE = 4


class TexturePyramid:
    """Mipmaps of P ≥ 1 square pages, for trilinear lookup.

    Pages are tileable pictures in [0, 1] (gamma 2.2), all of one size, a power of two. Colours are stored as bytes on a
    square-root scale and returned as linear light. Raises `ValueError` for pages of other shapes.
    """

    def __init__(self, pages: Sequence[Float32[np.ndarray, "size size 3"]]) -> None:
        self.size = pages[0].shape[0]
        if self.size & (self.size - 1) or any(page.shape != (self.size, self.size, 3) for page in pages):
            raise ValueError(f"pages must be square, of one size, a power of two: {[page.shape for page in pages]}")
        sizes = [self.size >> level for level in range(self.size.bit_length()) if self.size >> level >= SMALLEST_PAGE]
        lengths = [len(pages) * size * size for size in sizes]
        self._offsets = np.cumsum([0, *lengths[:-1]]).astype(np.int32)
        self._texels = np.empty(sum(lengths), np.int32)

        for number, page in enumerate(pages):
            linear = page.astype(np.float32) ** np.float32(2.2)
            for offset, size in zip(self._offsets, sizes, strict=True):
                start = offset + number * size * size
                self._texels[start : start + size * size] = _pack(linear)
                linear = (linear[::2] + linear[1::2]) / 2
                linear = (linear[:, ::2] + linear[:, 1::2]) / 2

    def lookup(
        self,
        page: Int32[np.ndarray, " n"],
        u: Float32[np.ndarray, " n"],
        v: Float32[np.ndarray, " n"],
        texels: Float32[np.ndarray, " n"],
    ) -> Float32[np.ndarray, "3 n"]:
        """Linear colours at (u, v), in pages with v upwards, filtered over `texels` texels of the finest level."""
        level = np.clip(np.log2(np.maximum(texels, 1)), 0, len(self._offsets) - 1.001)
        lower = level.astype(np.int32)
        weight = (level - lower).astype(np.float32)
        fine, coarse = self._bilinear(page, u, v, lower), self._bilinear(page, u, v, lower + 1)
        root = fine + (coarse - fine) * weight
        return root * root

    def _bilinear(self, page: np.ndarray, u: np.ndarray, v: np.ndarray, level: np.ndarray) -> np.ndarray:
        size = np.right_shift(np.int32(self.size), level)
        column, right = _split(u * size - np.float32(0.5))
        row, down = _split(-v * size - np.float32(0.5))
        last = size - 1
        start = self._offsets[level] + page * (size * size)
        upper = start + (row & last) * size
        below = start + ((row + 1) & last) * size
        column, next_column = column & last, (column + 1) & last
        colors = np.zeros((3, u.shape[0]), np.float32)
        for corner, share in (
            (upper + column, (1 - right) * (1 - down)),
            (upper + next_column, right * (1 - down)),
            (below + column, (1 - right) * down),
            (below + next_column, right * down),
        ):
            texel = self._texels[corner]
            share = share * np.float32(1 / 255)
            for channel in range(3):
                colors[channel] += ((texel >> (8 * channel)) & 255).astype(np.float32) * share
        return colors


def _pack(linear: np.ndarray) -> np.ndarray:
    """Square roots of the colours as bytes, three to a 32-bit word."""
    red, green, blue = (
        (np.sqrt(linear[..., channel]) * 255 + np.float32(0.5)).astype(np.int32) for channel in range(3)
    )
    return (red | green << 8 | blue << 16).reshape(-1)


def _split(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    whole = np.floor(position)
    return whole.astype(np.int32), position - whole
