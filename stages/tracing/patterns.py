"""Tileable patterns on a square page: noise, courses of bricks or books, stones, marks.

A page has `size` x `size` texels and tiles seamlessly. Values are float32 in [0, 1] unless stated otherwise. All
randomness comes from the generator passed in, so that the same seed gives the same page.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int

STRIP = 32
"""Rows of a page processed at a time, so that the working set fits in a core's own cache."""

Field = Float32[np.ndarray, "size size"]
Page = Float32[np.ndarray, "size size 3"]


def noise(size: int, period: int, generator: np.random.Generator, period_across: int | None = None) -> Field:
    """Value noise: random values on a lattice of `period` rows and `period_across` columns, smoothly interpolated."""
    lattice = generator.random((period, period_across or period), dtype=np.float32)
    return _stretch(np.ascontiguousarray(_stretch(lattice.T, size).T), size)


def _stretch(lattice: np.ndarray, size: int) -> np.ndarray:
    """Interpolate a periodic lattice along axis 0 to `size` rows, with smoothstep weights."""
    period = lattice.shape[0]
    position = np.arange(size, dtype=np.float32) * np.float32(period / size)
    row = position.astype(np.int64)
    weight = position - row
    weight = (weight * weight * (3 - 2 * weight))[:, None].astype(np.float32)
    rise = np.roll(lattice, -1, axis=0) - lattice
    return lattice[row % period] + rise[row % period] * weight


def fractal(size: int, period: int, generator: np.random.Generator, octaves: int = 6, gain: float = 0.6) -> Field:
    """Octaves of value noise from `period` up, each twice as fine and `gain` times as strong, scaled to fill [0, 1]."""
    total = np.zeros((size, size), np.float32)
    strength = 1.0
    for octave in range(octaves):
        frequency = period << octave
        if frequency > size // 2:
            break
        total += np.float32(strength) * noise(size, frequency, generator)
        strength *= gain
    return spread(total)


def spread(field: np.ndarray) -> np.ndarray:
    """Scale a field linearly so that it fills [0, 1]; a constant field becomes 0."""
    low, high = field.min(), field.max()
    return (field - low) / (high - low + np.float32(1e-9))


def step(field: np.ndarray, start: float, stop: float) -> np.ndarray:
    """Smoothstep: 0 below `start`, 1 above `stop`, smooth in between."""
    part = np.clip((field - np.float32(start)) * np.float32(1 / (stop - start)), 0, 1)
    return part * part * (3 - 2 * part)


@dataclass(frozen=True)
class Cells:
    """A page divided into cells: the index of each texel's cell, and its distance from the cell's border, in pages."""

    index: Int[np.ndarray, "size size"]
    inset: Field
    count: int

    def tone(self, generator: np.random.Generator) -> Field:
        """One random value per cell."""
        return generator.random(self.count, dtype=np.float32)[self.index]

    def color(self, palette: np.ndarray, generator: np.random.Generator) -> Page:
        """A random colour of the palette [K, 3] for each cell."""
        return palette[generator.integers(len(palette), size=self.count)][self.index].astype(np.float32)


def courses(
    size: int, rows: int, columns: int, generator: np.random.Generator, variation: float = 0.2, heights: float = 0.0
) -> Cells:
    """Rows of cells with staggered vertical joints: bricks, planks, tiles, books.

    `variation` sets how unequal the widths in a row are, `heights` in [0, 1) the heights of the rows; 0 is equal.
    """
    place = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / size
    row_edges = (np.arange(rows + 1) + np.r_[0, heights * (generator.random(rows - 1) - 0.5), 0]) / rows
    row = np.searchsorted(row_edges, place, side="right") - 1
    upright = np.minimum(place - row_edges[row], row_edges[row + 1] - place).astype(np.float32)
    index = np.empty((rows, size), np.int64)
    level = np.empty((rows, size), np.float32)
    for number in range(rows):
        shift = (number % 2) / 2 + variation * (generator.random() - 0.5)
        edges = np.sort((np.arange(columns) + shift + variation * (generator.random(columns) - 0.5)) / columns % 1)
        edges = np.r_[edges[-1] - 1, edges, edges[0] + 1]
        column = np.searchsorted(edges, place, side="right") - 1
        level[number] = np.minimum(place - edges[column], edges[column + 1] - place)
        index[number] = number * columns + (column - 1) % columns
    return Cells(index[row], np.minimum(level[row], upright[:, None]), rows * columns)


def stones(size: int, count: int, generator: np.random.Generator, regularity: float = 0.0) -> Cells:
    """Voronoi cells of a `count` x `count` grid of seeds, jittered by 1 - `regularity` squares: cobbles, leaves."""
    jitter = generator.random((count, count, 2), dtype=np.float32) * np.float32(1 - regularity) + np.float32(
        regularity / 2
    )
    place = (np.arange(size, dtype=np.float32) + np.float32(0.5)) * np.float32(count / size)
    square = place.astype(np.int64)
    index = np.empty((size, size), np.int64)
    inset = np.empty((size, size), np.float32)
    for top in range(0, size, STRIP):
        strip = slice(top, top + STRIP)
        index[strip], inset[strip] = _nearest_seeds(jitter, place[strip], square[strip], place, square)
    return Cells(index, inset * np.float32(0.5 / count), count * count)


def _nearest_seeds(
    jitter: np.ndarray, rows: np.ndarray, row_squares: np.ndarray, columns: np.ndarray, column_squares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For each texel the index of the nearest seed, and how much farther the second nearest is, in grid squares."""
    count = len(jitter)
    first = np.full((len(rows), len(columns)), np.inf, np.float32)
    second = first.copy()
    index = np.zeros(first.shape, np.int32)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row, column = (row_squares + down) % count, (column_squares + right) % count
            seeds = jitter[row]
            delta_y = seeds[:, column, 0] - (rows - row_squares - np.float32(down))[:, None]
            delta_x = seeds[:, column, 1] - (columns - column_squares - np.float32(right))[None]
            distance = (delta_x * delta_x + delta_y * delta_y).astype(np.float32)
            nearer = distance < first
            second = np.where(nearer, first, np.minimum(second, distance))
            first = np.minimum(first, distance)
            index = np.where(nearer, (row[:, None] * count + column[None]).astype(np.int32), index)
    return index, np.sqrt(second) - np.sqrt(first)


def marks(size: int, lines: int, generator: np.random.Generator, fill: float = 0.75) -> Field:
    """Lines of random glyphs, like distant writing: 1 where there is ink. `fill` is the probability of a glyph."""
    rows, columns = 8, 6
    across = lines * 2
    glyphs = (generator.random((lines, across, rows - 2, columns - 2)) < 0.5).astype(np.float32)
    strokes = np.zeros((lines, across, rows, columns), np.float32)
    strokes[:, :, 1:-1, 1:-1] = glyphs
    strokes *= (generator.random((lines, across, 1, 1)) < fill).astype(np.float32)
    page = strokes.transpose(0, 2, 1, 3).reshape(lines * rows, across * columns)
    row = np.arange(size) * page.shape[0] // size
    column = np.arange(size) * page.shape[1] // size
    return page[row[:, None], column[None, :]]


def warp(picture: np.ndarray, amount: float, period: int, generator: np.random.Generator) -> np.ndarray:
    """Displace the texels of a page by fractal noise, by up to `amount` / 2 pages along each axis."""
    size = picture.shape[0]
    place = np.arange(size)
    shift = [((fractal(size, period, generator, 3) - 0.5) * (amount * size)).astype(np.int64) for _ in range(2)]
    return picture[(place[:, None] + shift[0]) % size, (place[None, :] + shift[1]) % size]


def soften(picture: Page, block: int, strength: float) -> Page:
    """Scale contrast finer than `block` texels by `strength`; `block` must divide the page's size."""
    size = picture.shape[0]
    coarse = picture.reshape(size // block, block, size // block, block, 3).mean(axis=(1, 3))
    for axis in (0, 1):
        place = (np.arange(size) + 0.5) / block - 0.5
        start = np.floor(place).astype(np.int64)
        weight = np.expand_dims((place - start).astype(np.float32), (1 - axis, 2))
        low, high = (np.take(coarse, number % (size // block), axis) for number in (start, start + 1))
        coarse = low + (high - low) * weight
    return np.clip(coarse + np.float32(strength) * (picture - coarse), 0, 1).astype(np.float32)


def relief(height: np.ndarray, strength: float) -> np.ndarray:
    """Shading of a height field lit from one corner: factors in [0.4, 1.6], 1 where it is flat."""
    slope = 2 * height - np.roll(height, 1, axis=0) - np.roll(height, 1, axis=1)
    return np.clip(1 + np.float32(strength) * slope, 0.4, 1.6)


def mix(start: np.ndarray, stop: np.ndarray, weight: np.ndarray) -> Page:
    """Interpolate linearly from colour or picture `start` to `stop` by a field of weights."""
    part = weight[..., None]
    return (start * (1 - part) + stop * part).astype(np.float32)


def shade(picture: np.ndarray, factor: np.ndarray) -> Page:
    """Multiply a picture by a field of factors, clamped to [0, 1]."""
    return np.clip(picture * factor[..., None], 0, 1).astype(np.float32)


def rgb(code: str) -> np.ndarray:
    """The colour [3] of a hex code such as "c8a070", float32 in [0, 1]."""
    return np.frombuffer(bytes.fromhex(code), np.uint8).astype(np.float32) / 255


def palette(*codes: str) -> np.ndarray:
    """The colours [K, 3] of K hex codes."""
    return np.stack([rgb(code) for code in codes])
