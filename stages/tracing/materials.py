"""Procedural textures shared by several scenes. Each takes a generator and colours, and returns a page."""

from __future__ import annotations

import numpy as np

from stages.tracing.patterns import (
    Field,
    Page,
    courses,
    fractal,
    marks,
    mix,
    noise,
    relief,
    rgb,
    shade,
    spread,
    step,
    stones,
    warp,
)
from stages.tracing.world import PAGE_SIZE as SIZE


def mottled(
    generator: np.random.Generator, dark: np.ndarray, bright: np.ndarray, period: int = 4, rough: float = 0.5
) -> Page:
    """Plaster, stone or soil: fractal clouds of two colours, with fine grain."""
    field = fractal(SIZE, period, generator, octaves=8, gain=0.55 + 0.25 * rough)
    grain = fractal(SIZE, 64, generator, octaves=3, gain=0.8)
    return shade(mix(dark, bright, step(field, 0.2, 0.8)), 0.8 + 0.4 * grain)


def bricks(generator: np.random.Generator, colors: np.ndarray, mortar: np.ndarray, rows: int, columns: int) -> Page:
    """Courses of bricks with chipped edges, each of its own tone, stained by soot."""
    size = 30 / rows
    wall = courses(SIZE, rows, columns, generator, variation=0.35, heights=0.3)
    rough = fractal(SIZE, 32, generator, octaves=4, gain=0.75)
    body = step(wall.inset + (rough - 0.5) * (0.004 * size), 0.002 * size, 0.0045 * size)
    brick = shade(wall.color(colors, generator), 0.7 + 0.35 * wall.tone(generator) + 0.25 * (rough - 0.5))
    stain = fractal(SIZE, 3, generator, octaves=5)
    picture = mix(mortar * (0.7 + 0.4 * rough[..., None]), brick, body)
    return shade(picture, relief(body + rough * 0.3, 0.4) * (0.75 + 0.4 * stain))


def cobbles(generator: np.random.Generator, colors: np.ndarray, joint: np.ndarray, count: int) -> Page:
    """Rounded, grainy stones in a bed, each of its own tone."""
    bed = stones(SIZE, count, generator, regularity=0.45)
    dome = step(bed.inset * count, 0.02, 0.32)
    grain = fractal(SIZE, 48, generator, octaves=4, gain=0.8)
    stone = shade(bed.color(colors, generator), 0.65 + 0.3 * bed.tone(generator) + 0.3 * grain)
    picture = mix(joint * (0.6 + 0.6 * grain[..., None]), stone, step(bed.inset * count, 0.03, 0.09))
    return shade(
        picture, (0.7 + 0.35 * dome) * relief(dome, 1.5) * (0.8 + 0.35 * fractal(SIZE, 3, generator, octaves=4))
    )


def planks(generator: np.random.Generator, colors: np.ndarray, rows: int, columns: int) -> Page:
    """Boards that run from left to right, with grain, knots and dark joints."""
    boards = courses(SIZE, rows, columns, generator, variation=0.8, heights=0.2)
    lean = boards.tone(generator)
    grain = spread(
        noise(SIZE, 256, generator, 6) + noise(SIZE, 96, generator, 4) + 0.7 * noise(SIZE, 512, generator, 24)
    )
    knots = np.roll(fractal(SIZE, rows, generator, octaves=3), generator.integers(SIZE), axis=1)
    rings = 0.5 + 0.5 * np.sin((knots * 60 + lean * 40).astype(np.float32))
    tone = 0.62 + 0.3 * lean + 0.3 * (grain - 0.5) + 0.1 * rings * step(knots, 0.55, 0.8)
    wood = shade(boards.color(colors, generator), tone)
    picture = mix(rgb("140c08"), wood, step(boards.inset, 0.0006, 0.0026))
    return shade(picture, 0.85 + 0.3 * fractal(SIZE, 4, generator, octaves=5))


def leaves(
    generator: np.random.Generator, colors: np.ndarray, count: int = 44, flowers: np.ndarray | None = None
) -> Page:
    """Leaves with dark gaps between them; with `flowers` [K, 3], some cells bloom."""
    foliage = stones(SIZE, count, generator)
    lit = step(foliage.inset * count, 0.0, 0.35)
    picture = shade(foliage.color(colors, generator), 0.35 + 0.35 * lit + 0.4 * foliage.tone(generator))
    veins = spread(noise(SIZE, 256, generator))
    picture = shade(picture, 0.8 + 0.35 * veins)
    if flowers is not None:
        blooms = stones(SIZE, count // 3, generator)
        bloom = blooms.color(flowers, generator)
        part = step(blooms.inset * count / 3, 0.22, 0.26) * (blooms.tone(generator) > 0.45)
        picture = mix(picture, shade(bloom, 0.7 + 0.4 * lit), part.astype(np.float32))
    return shade(picture, 0.7 + 0.45 * fractal(SIZE, 5, generator, octaves=4))


def shelves(
    generator: np.random.Generator, colors: np.ndarray, wood: np.ndarray, rows: int = 6, columns: int = 34
) -> Page:
    """Bookshelves: spines of various widths, heights and colours, with bands and gilt titles, on wooden boards."""
    size = 6 / rows
    books = courses(SIZE, rows, columns, generator, variation=1.1)
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE
    up = np.broadcast_to((1 - (place * rows) % 1)[:, None], (SIZE, SIZE))
    top = 0.74 + 0.24 * books.tone(generator)
    round_back = step(books.inset, 0.0, 0.008 * size)
    grain = fractal(SIZE, 64, generator, octaves=4, gain=0.8)
    picture = shade(
        books.color(colors, generator),
        (0.5 + 0.5 * books.tone(generator)) * (0.45 + 0.6 * round_back) + 0.25 * (grain - 0.5),
    )
    for _ in range(3):
        height = 0.2 + 0.6 * books.tone(generator)
        band = (np.abs(up - height) < 0.012 + 0.03 * books.tone(generator)) & (books.tone(generator) < 0.6)
        picture = mix(
            picture,
            books.color(np.stack([rgb("d8b45c"), rgb("20140c"), rgb("e8dcc0")]), generator),
            band.astype(np.float32),
        )
    written = (up > 0.3) & (up < 0.62) & (books.tone(generator) < 0.7)
    title = marks(SIZE, 15 * rows, generator).T * written * step(books.inset, 0.003 * size, 0.005 * size)
    picture = mix(picture, rgb("e0c070"), title * 0.8)
    board = mix(wood * 0.5, wood, spread(noise(SIZE, 300, generator, 8)))
    picture = mix(picture, rgb("0c0705"), ((up > top) | (books.tone(generator) < 0.05)).astype(np.float32))
    return mix(picture, board, (up < 0.09).astype(np.float32))


def mosaic(generator: np.random.Generator, colors: np.ndarray, ground: np.ndarray, count: int) -> Page:
    """Square glazed tiles, each with its own rosette and corner pieces, most with a ring."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE * count
    row = place.astype(np.int64)
    x = np.broadcast_to(2 * (place % 1) - 1, (SIZE, SIZE))
    y = x.T
    cell = row[:, None] * count + row[None, :]

    def pick() -> Field:
        return generator.random(count * count, dtype=np.float32)[cell]

    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    petals = 0.55 + 0.3 * np.cos(angle * (2 + (pick() * 5).astype(np.int64)) + 6 * pick())
    inner = step(petals - radius, 0.0, 0.08)
    ring = step(0.09 - np.abs(radius - 0.4 - 0.4 * pick()), 0.0, 0.04)
    corner = step(np.abs(x) + np.abs(y), 1.3 + 0.3 * pick().mean(), 1.4)

    def color() -> Page:
        return colors[generator.integers(len(colors), size=count * count)][cell].astype(np.float32)

    picture = mix(np.broadcast_to(ground, (SIZE, SIZE, 3)), color(), inner)
    picture = mix(picture, color(), ring * (pick() < 0.7))
    picture = mix(picture, color(), corner)
    edge = 1 - np.maximum(np.abs(x), np.abs(y))
    picture = mix(ground * 0.45, picture, step(edge, 0.02, 0.06))
    glaze = fractal(SIZE, 24, generator, octaves=5, gain=0.7)
    return shade(picture, (0.75 + 0.25 * pick()) * (0.8 + 0.35 * glaze))


def cloth(generator: np.random.Generator, colors: np.ndarray, stripes: int) -> Page:
    """Woven stripes of unequal widths, faded in places."""
    bands = courses(SIZE, 1, stripes, generator, variation=0.7)
    picture = bands.color(colors, generator)
    weave = 0.5 * noise(SIZE, 340, generator) + 0.5 * noise(SIZE, 128, generator, 512)
    return shade(picture, (0.75 + 0.35 * fractal(SIZE, 4, generator, octaves=6)) * (0.85 + 0.3 * weave))


def painted_metal(generator: np.random.Generator, color: np.ndarray, rust: np.ndarray, wear: float = 0.5) -> Page:
    """Paint over steel: scratches, chips that expose rust, and vertical streaks of dirt."""
    field = fractal(SIZE, 5, generator, octaves=8, gain=0.72)
    chips = step(field, 0.78 - 0.2 * wear, 0.8 - 0.2 * wear)
    runs = spread(noise(SIZE, 6, generator, 90))
    scratches = step(np.minimum(noise(SIZE, 20, generator, 400), noise(SIZE, 400, generator, 26)), 0.0, 0.12)
    paint = shade(
        np.broadcast_to(color, (SIZE, SIZE, 3)), 0.72 + 0.3 * fractal(SIZE, 3, generator, octaves=6) + 0.15 * runs
    )
    paint = mix(np.minimum(paint * 1.25 + 0.06, 1), paint, scratches)
    below = shade(np.broadcast_to(rust, (SIZE, SIZE, 3)), 0.5 + 0.7 * fractal(SIZE, 40, generator, octaves=4, gain=0.8))
    return shade(mix(paint, below, chips), relief(1 - chips, 0.25))


def writing(generator: np.random.Generator, paper: np.ndarray, ink: np.ndarray, lines: int) -> Page:
    """A page of text blocks with margins, a few pictures and mottled paper."""
    text = marks(SIZE, lines, generator)
    blocks = courses(SIZE, 7, 3, generator, variation=0.4, heights=0.5)
    text = text * step(blocks.inset, 0.012, 0.016) * (blocks.tone(generator) < 0.8)
    sheet = shade(np.broadcast_to(paper, (SIZE, SIZE, 3)), 0.78 + 0.25 * fractal(SIZE, 5, generator, octaves=6))
    plate = step(blocks.inset, 0.018, 0.02) * (blocks.tone(generator) < 0.2)
    drawing = blocks.color(np.stack([rgb("8c3020"), rgb("2c5070"), rgb("5c6c30"), rgb("b88430")]), generator)
    sheet = mix(sheet, shade(drawing, 0.5 + 0.7 * fractal(SIZE, 24, generator, octaves=5)), plate)
    return mix(sheet, ink, text * (1 - plate) * 0.85)


def clouds(generator: np.random.Generator, zenith: np.ndarray, horizon: np.ndarray, cloud: np.ndarray) -> Page:
    """A sky for a dome: the zenith at the centre of the page, the horizon about halfway to its edge."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE - np.float32(0.5)
    distance = np.hypot(place[:, None], place[None, :])
    sky = mix(zenith, horizon, step(distance, 0.02, 0.27))
    field = warp(fractal(SIZE, 7, generator, octaves=7, gain=0.58), 0.04, 6, generator)
    return mix(
        sky, cloud * (0.85 + 0.15 * fractal(SIZE, 12, generator, octaves=5)[..., None]), step(field, 0.48, 0.78) * 0.9
    )
