"""Textures of the workshop: worn paint, concrete, corrugated sheets, rubber, tools and goods."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from stages.tracing import materials
from stages.tracing.patterns import Page, courses, fractal, marks, mix, palette, rgb, shade, step, stones, warp
from stages.tracing.world import PAGE_SIZE as SIZE

RUST = rgb("8a5232")
GOODS = palette("d2382c", "e8b622", "1f9ab0", "e7e3d6", "3f8a4c", "e0742a", "3a5aa8", "8d9aa2", "b84a78")


def machine_paint(generator: np.random.Generator, color: np.ndarray) -> Page:
    """Worn paint on sheet-metal plates with seams, each of its own tone, some with stencilled words."""
    plates = courses(SIZE, 5, 4, generator, variation=0.8, heights=0.6)
    body = step(plates.inset, 0.002, 0.006)
    paint = materials.painted_metal(generator, color, RUST, wear=0.35)
    words = marks(SIZE, 22, generator) * step(plates.inset, 0.03, 0.032) * (plates.tone(generator) < 0.25)
    paint = mix(paint, rgb("f4f0e4") if color.mean() < 0.55 else rgb("22262a"), words * 0.8)
    return shade(paint, (0.5 + 0.5 * body) * (0.8 + 0.3 * plates.tone(generator)))


def concrete(generator: np.random.Generator) -> Page:
    """A concrete floor with hairline cracks, oil stains and splashes of paint."""
    slab = materials.mottled(generator, rgb("62686a"), rgb("a6aaa6"), 6, rough=0.9)
    cracks = warp(stones(SIZE, 6, generator).inset, 0.05, 8, generator)
    slab = shade(slab, 0.5 + 0.5 * step(cracks, 0.0004, 0.002))
    oil = step(warp(fractal(SIZE, 6, generator, octaves=4), 0.06, 12, generator), 0.62, 0.74)
    slab = mix(slab, slab * rgb("6c6052"), oil)
    drops = stones(SIZE, 44, generator)
    splash = step(warp(drops.inset, 0.01, 30, generator) * 44, 0.2, 0.28) * (drops.tone(generator) > 0.9)
    slab = mix(slab, drops.color(GOODS, generator), splash * 0.75)
    return shade(slab, 0.75 + 0.4 * fractal(SIZE, 3, generator, octaves=5))


def corrugated(generator: np.random.Generator, colors: np.ndarray, ribs: int) -> Page:
    """Overlapping sheets of corrugated metal in several colours, with vertical streaks of rust."""
    sheets = courses(SIZE, 3, 6, generator, variation=0.9, heights=0.5)
    metal = materials.painted_metal(generator, rgb("f0f0ee"), RUST, wear=0.6)
    streaks = step(fractal(SIZE, 40, generator, octaves=3)[:1] * fractal(SIZE, 4, generator), 0.3, 0.65)
    paint = mix(sheets.color(colors, generator) * metal, RUST * metal, streaks * 0.7)
    words = marks(SIZE, 14, generator) * step(sheets.inset, 0.04, 0.042) * (sheets.tone(generator) < 0.2)
    paint = mix(paint, rgb("2c3238"), words * 0.7)
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE
    wave = 0.88 + 0.17 * np.cos(2 * np.pi * ribs * place)[None, :].astype(np.float32)
    return shade(paint, wave * (0.5 + 0.5 * step(sheets.inset, 0.001, 0.005)) * (0.8 + 0.3 * sheets.tone(generator)))


def rubber(generator: np.random.Generator) -> Page:
    """Tyre treads covered in grey dust and dried mud."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE
    bend = np.abs(2 * (4 * place % 1) - 1)[:, None]
    lugs = warp(step(np.sin(2 * np.pi * (8 * place[None, :] + 0.8 * bend)), -0.5, -0.1), 0.03, 8, generator)
    paint = mix(rgb("3a3b40"), rgb("7c7a7c"), step(fractal(SIZE, 8, generator, octaves=7, gain=0.7), 0.2, 0.8))
    paint = mix(paint, rgb("9c8464"), step(fractal(SIZE, 6, generator, octaves=6), 0.55, 0.8))
    return shade(paint, (0.6 + 0.4 * lugs))


def _grid(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray, Int[np.ndarray, "size size"]]:
    """Each texel's position in its cell of a grid, x right and y up in [-1, 1], and the index of the cell."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE
    across, down = place * columns, place * rows
    cell = down.astype(np.int64)[:, None] * columns + across.astype(np.int64)[None, :]
    x, y = 2 * (across % 1) - 1, 1 - 2 * (down % 1)
    return np.broadcast_to(x, (SIZE, SIZE)), np.broadcast_to(y[:, None], (SIZE, SIZE)), cell


def pegboard(generator: np.random.Generator, rows: int, columns: int) -> Page:
    """Hammers, spanners and files, no two alike, on a perforated board."""
    x, y, cell = _grid(rows, columns)

    def pick() -> np.ndarray:
        return generator.random(rows * columns, dtype=np.float32)[cell]

    x = x + (pick() - 0.5) * 0.4 * y + (pick() - 0.5) * 0.3
    length = 0.4 + 0.4 * pick()
    handle = step(0.16 + 0.16 * pick() - np.abs(x), 0, 0.06) * step(length - np.abs(y + 0.1), 0, 0.04)
    above = y - length + 0.1
    ring = step(0.14 - np.abs(np.hypot(x * 0.7, above) - 0.16 - 0.12 * pick()), 0, 0.04)
    bar = step(0.2 - np.abs(above), 0, 0.04) * step(0.3 + 0.5 * pick() - np.abs(x + 0.3 * (pick() - 0.5)), 0, 0.05)
    kind = pick()
    head = np.where(kind < 0.35, ring, np.where(kind < 0.8, bar, 0))
    hole_x, hole_y, _ = _grid(70, 70)
    board = materials.mottled(generator, rgb("9fa89c"), rgb("dcdccc"), 8)
    board = shade(board, 0.4 + 0.6 * step(np.hypot(hole_x, hole_y), 0.25, 0.4))
    board = shade(board, 1 - 0.5 * np.roll(np.maximum(handle, head), (9, 7), axis=(0, 1)))
    grain = 0.6 + 0.5 * fractal(SIZE, 24, generator, octaves=5, gain=0.75)
    tools = mix(board, shade(GOODS[generator.integers(len(GOODS), size=rows * columns)][cell], grain), handle)
    return mix(tools, shade(np.broadcast_to(rgb("7c868e"), tools.shape), grain), head)


def packed_goods(generator: np.random.Generator, rows: int, columns: int) -> Page:
    """Tightly packed boxes and cans of many colours, with labels and dents."""
    packs = courses(SIZE, rows, columns, generator, variation=0.8, heights=0.3)
    _, y, _ = _grid(rows, 1)
    band = step(0.25 + 0.3 * packs.tone(generator) - np.abs(y - 0.4 * (packs.tone(generator) - 0.5)), 0, 0.03)
    picture = mix(packs.color(GOODS, generator), packs.color(GOODS, generator), band)
    words = marks(SIZE, 7 * rows, generator) * band * step(packs.inset, 0.008, 0.012)
    picture = mix(picture, packs.color(palette("26282c", "26282c", "f4f0e6"), generator), words * 0.85)
    dents = fractal(SIZE, 12, generator, octaves=7, gain=0.7)
    edge = step(packs.inset, 0.001, 0.02)
    return shade(picture, (0.45 + 0.5 * edge) * (0.75 + 0.3 * packs.tone(generator)) * (0.75 + 0.5 * dents))
