"""An old library: walls of books, stained glass, a reading table under a chandelier, globes, busts and warm lamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.tracing import materials
from stages.tracing.patterns import Page, courses, fractal, marks, mix, palette, rgb, shade, step, stones, warp
from stages.tracing.world import PAGE_SIZE as SIZE
from stages.tracing.world import Builder, Material, Sky, Vector, World, turned

WALL = 6.25
CEILING = 4.7
SHELF_ROWS = 6
TABLE_TOP = 0.74
COVERS = (
    palette("a8322a", "2f6b48", "c8963c", "33507e", "7c3450", "8a5a34", "4f7a34", "d8c490", "5c2c24", "2c6a72") ** 1.8
)
"""Linear tints for `leather`."""


@dataclass(frozen=True)
class Stuff:
    """The materials that the furniture shares."""

    wood: Material
    leather: Material
    paper: Material
    brass: Material
    marble: Material
    glass: Material
    map: Material
    cases: tuple[Material, ...]
    low_cases: Material


def build(seed: int) -> World:
    """Build the library; `seed` determines textures, tones and small displacements."""
    generator = np.random.default_rng([seed, 2])
    builder = Builder(generator)
    spines = (
        palette("8c2a22", "a8443a", "5c1f1c", "c09048", "3c2418"),
        palette("2f5c3c", "4a7a44", "1f3f34", "b08c4c", "d0bc8c"),
        palette("7a4a28", "a06c38", "8c2a22", "2f5c3c", "2c4468", "c8a860"),
    )
    boards = palette("84502c", "6a3c20", "9a6236", "74462a")
    stuff = Stuff(
        wood=builder.material(materials.planks(generator, boards, 11, 2), 1.2, gloss=0.25),
        leather=builder.material(_leather(generator), 0.9, gloss=0.15),
        paper=builder.material(materials.writing(generator, rgb("f0e2bc"), rgb("2c2018"), 56), 1.1),
        brass=builder.material(materials.mottled(generator, rgb("8a5c1c"), rgb("f0c860"), 12), 0.8, gloss=0.7),
        marble=builder.material(materials.mottled(generator, rgb("9c8c74"), rgb("ece0c8"), 7), 1.1, gloss=0.2),
        glass=builder.material(_stained_glass(generator), 1.5, gloss=0.4, glow=0.6),
        map=builder.material(_chart(generator), 1.3, gloss=0.3),
        cases=tuple(
            builder.material(materials.shelves(generator, colors, rgb("7a4826"), 15, 85), 6.75) for colors in spines
        ),
        low_cases=builder.material(materials.shelves(generator, spines[2], rgb("7a4826")), 1.86),
    )
    _room(builder, generator, stuff)
    _walls(builder, generator, stuff)
    _table(builder, generator, stuff)
    _chandelier(builder, stuff)
    _furniture(builder, stuff)
    _corners(builder, stuff)
    builder.sun((0.42, -0.36, 0.83), (1.15, 1.0, 0.74))
    return builder.world(Sky(above=(0.44, 0.42, 0.38), below=(0.23, 0.19, 0.14)))


def _leather(generator: np.random.Generator) -> Page:
    """Pale worn leather, to be tinted, with gilt lettering."""
    hide = materials.mottled(generator, rgb("8c8074"), rgb("f4ece0"), 10, rough=0.8)
    hide = shade(hide, 0.7 + 0.3 * step(stones(SIZE, 60, generator).inset * 60, 0.0, 0.12))
    panels = courses(SIZE, 9, 7, generator, variation=0.5, heights=0.4)
    gilt = marks(SIZE, 44, generator) * step(panels.inset, 0.016, 0.018) * (panels.tone(generator) < 0.4)
    return mix(hide, rgb("fff0a8"), gilt * 0.8)


def _stained_glass(generator: np.random.Generator) -> Page:
    """Leaded panes of coloured glass in two sizes."""
    colors = palette("c83028", "e8b040", "3c8c4c", "e8d8a0", "a84a20", "2f6c8c", "d8902c")
    large, small = stones(SIZE, 9, generator), stones(SIZE, 26, generator)
    picture = mix(
        large.color(colors, generator),
        small.color(colors, generator),
        (large.tone(generator) < 0.6).astype(np.float32) * 0.8,
    )
    picture = shade(
        picture, (0.6 + 0.4 * small.tone(generator)) * (0.7 + 0.4 * fractal(SIZE, 20, generator, octaves=5))
    )
    return mix(rgb("241c14"), picture, step(large.inset, 0.002, 0.004) * step(small.inset, 0.001, 0.002))


def _chart(generator: np.random.Generator) -> Page:
    """The map on a globe: seas, lands of many colours, and place names."""
    height = fractal(SIZE, 4, generator, octaves=8, gain=0.6)
    realms = stones(SIZE, 16, generator).color(palette("c8a050", "b06c38", "8c9c4c", "d8c080", "a84a38"), generator)
    sea = shade(np.broadcast_to(rgb("3c7c78"), (SIZE, SIZE, 3)), 0.7 + 0.5 * fractal(SIZE, 16, generator, octaves=5))
    land = shade(warp(realms, 0.05, 8, generator), 0.65 + 0.6 * fractal(SIZE, 32, generator, octaves=4, gain=0.8))
    picture = mix(mix(sea, rgb("f0dca0"), step(height, 0.46, 0.5)), land, step(height, 0.5, 0.51))
    return mix(picture, rgb("2c1c10"), marks(SIZE, 64, generator, fill=0.3) * 0.7)


def _carpet(generator: np.random.Generator) -> Page:
    """A knotted carpet: a field of rosettes within four borders, with a medallion at the centre."""
    colors = palette("c89040", "7c1c20", "dcc898", "2c4a44", "a02c28", "a85028", "6c1420")
    borders = ((0.3, "24443a", 34), (0.35, "b8863c", 60), (0.375, "6c1820", 26), (0.45, "203048", 50))
    place = np.abs((np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE - np.float32(0.5))
    edge = np.maximum(place[:, None] * 1.3, place[None, :])
    picture = materials.mosaic(generator, colors, rgb("8c1c20"), 27)
    for reach, ground, count in borders:
        picture = mix(
            picture, materials.mosaic(generator, colors, rgb(ground), count), step(edge, reach, reach + 0.002)
        )
    medallion = step(0.17 - np.hypot(place[:, None], place[None, :] * 0.8), 0.0, 0.004)
    picture = mix(picture, materials.mosaic(generator, colors, rgb("24443a"), 42), medallion)
    return shade(warp(picture, 0.006, 24, generator), 0.7 + 0.4 * fractal(SIZE, 90, generator, octaves=3, gain=0.9))


def _room(builder: Builder, generator: np.random.Generator, stuff: Stuff) -> None:
    boards = palette("a8703c", "8c5a30", "b88048", "74482a", "9c6436")
    floor = builder.material(materials.planks(generator, boards, 26, 5), 5.6, gloss=0.3)
    builder.box((0, 0, -0.5), (9, 9, 0.5), floor, axes=turned(yaw=24), casts_shadow=False)
    extent = 6.4
    carpet = builder.material(_carpet(generator), extent)
    middle = (0.5 - 3 * 0.731 / extent, 0.5)
    builder.box((0, 0, 0.01), (2.9, 2.2, 0.015), carpet, axes=turned(yaw=12), patch=middle, casts_shadow=False)
    coffers = materials.bricks(generator, palette("6c4426", "84582e", "5c3a22", "3c5440"), rgb("2c1a10"), 9, 9)
    ceiling = builder.material(coffers, 5.0)
    builder.box((0, 0, CEILING + 0.5), (9, 9, 0.5), ceiling, casts_shadow=False)
    for x in (-4.2, -1.4, 1.4, 4.2):
        builder.box((x, 0, CEILING - 0.1), (0.13, 6.5, 0.13), stuff.wood, tint=builder.tone(0.2), casts_shadow=False)


def _walls(builder: Builder, generator: np.random.Generator, stuff: Stuff) -> None:
    green = palette("4c7850", "8a9c54", "c8a850", "2f5840")
    tapestry = builder.material(materials.leaves(generator, green, 30, palette("b83a2c", "e0b850")), 3.0)
    oils = materials.leaves(generator, palette("a8322a", "2f6b48", "c8963c", "33507e", "d8c490"), 24)
    painting = builder.material(warp(oils, 0.08, 6, generator), 2.0, gloss=0.2)
    windows = {(0, 1), (1, 3), (2, 2), (3, 0), (3, 3)}
    # Each bookcase shows a different sixth of a page: structure from motion would confuse cases that look alike.
    parts = [(case, column / 3, row * 7 / 15) for case in stuff.cases for column in range(3) for row in range(2)]
    order = iter(generator.permutation(len(parts)))
    for side in range(4):
        axes = turned(yaw=90 * side)
        outward, sideways, up = axes
        builder.box(outward * (WALL + 0.3) + up * 2.5, (0.3, 7, 2.5), tapestry, axes=axes, casts_shadow=False)
        builder.box(outward * 5.86 + up * 3.25, (0.36, 6.4, 0.08), stuff.wood, axes=axes, casts_shadow=False)
        for number in range(5):
            middle = outward * 5.95 + sideways * 2.3 * (number - 2)
            post = middle + sideways * 1.15 + up * 1.6
            builder.box(post, (0.36, 0.1, 1.6), stuff.wood, axes=axes, tint=builder.tone(0.2), casts_shadow=False)
            if (side, number) in windows:
                _window(builder, middle, axes, stuff)
                continue
            case, across, up_page = parts[next(order)]
            patch = (across, up_page + 0.1 / 15 + 1.6 / case.extent)
            half, tint = (0.28, 1.1, 1.6), builder.tone(0.25)
            builder.box(middle + up * 1.6, half, case, axes=axes, patch=patch, tint=tint, casts_shadow=False)
            if number % 2:
                continue
            face, width = middle + outward * 0.3 + up * 3.95, generator.uniform(0.4, 0.7)
            builder.box(face, (0.06, width, 0.42), stuff.brass, axes=axes, casts_shadow=False)
            tint = builder.tone(0.3)
            builder.box(face, (0.08, width - 0.08, 0.34), painting, axes=axes, tint=tint, casts_shadow=False)


def _window(builder: Builder, middle: np.ndarray, axes: np.ndarray, stuff: Stuff) -> None:
    outward, sideways, up = axes
    builder.box(middle + up * 0.35, (0.3, 1.05, 0.35), stuff.marble, axes=axes, casts_shadow=False)
    builder.box(middle + up * 1.95 + outward * 0.1, (0.1, 1.05, 1.25), stuff.glass, axes=axes, casts_shadow=False)
    for shift in (-0.36, 0.36):
        foot = middle + sideways * shift + up * 0.7 - outward * 0.05
        builder.rod(foot, foot + up * 2.5, 0.045, stuff.marble, casts_shadow=False)
    builder.ball(middle - outward * 0.15 + up * 0.85, (0.14, 0.14, 0.2), stuff.map, tint=builder.tone(0.4))


def _stack(builder: Builder, stuff: Stuff, place: Vector, count: int, size: float = 0.15) -> None:
    """A stack of closed books: leather covers, with the pages showing on three sides."""
    centre = np.asarray(place, np.float64)
    for _ in range(count):
        axes = turned(yaw=builder.generator.uniform(0, 360))
        width, thick = size * builder.generator.uniform(0.75, 1.1), builder.generator.uniform(0.022, 0.042)
        tint = COVERS[builder.generator.integers(len(COVERS))] * builder.tone(0.2) * 1.25
        centre = centre + axes[2] * thick
        builder.box(centre, (0.75 * width, width, thick), stuff.leather, axes=axes, bevel=0.008, tint=tint)
        sheets = (0.75 * width, width + 0.004, 0.68 * thick)
        builder.box(centre + axes[0] * 0.008, sheets, stuff.paper, axes=axes)
        centre = centre + axes[2] * thick


def _open_book(builder: Builder, stuff: Stuff, place: Vector, yaw: float, size: float = 0.2, slope: float = 0) -> None:
    axes, tint = turned(yaw, slope), COVERS[builder.generator.integers(len(COVERS))]
    builder.box(place, (size * 0.78, size * 1.06, 0.012), stuff.leather, axes=axes, tint=tint)
    for side in (-1, 1):
        centre = np.asarray(place) + axes[1] * side * size * 0.5 + axes[2] * 0.03
        builder.box(centre, (size * 0.7, size * 0.49, 0.02), stuff.paper, axes=turned(yaw, slope, -7 * side))


def _lamp(builder: Builder, stuff: Stuff, x: float, y: float, z: float, height: float = 0.34) -> None:
    builder.rod((x, y, z), (x, y, z + 0.03), 0.09, stuff.brass, end_radius=0.06)
    builder.rod((x, y, z), (x, y, z + height), 0.016, stuff.brass)
    builder.rod((x, y, z + height - 0.04), (x, y, z + height + 0.1), 0.17, stuff.glass, end_radius=0.07)
    builder.lamp((x, y, z + height + 0.12), (0.75, 0.48, 0.2), 0.9)


def _candlestick(builder: Builder, stuff: Stuff, x: float, y: float, z: float, height: float) -> None:
    builder.rod((x, y, z), (x, y, z + 0.05), 0.06, stuff.brass, end_radius=0.02)
    builder.rod((x, y, z), (x, y, z + height), 0.018, stuff.brass)
    builder.rod((x, y, z + height), (x, y, z + height + 0.03), 0.02, stuff.brass, end_radius=0.05)
    builder.rod((x, y, z + height), (x, y, z + height + 0.14), 0.022, stuff.marble)


def _globe(builder: Builder, stuff: Stuff, x: float, y: float, z: float, radius: float) -> None:
    lean = np.array([0.35, 0.1, 0.93]) * (radius * 1.25)
    middle = np.array([x, y, z + radius * 1.9])
    builder.rod((x, y, z), (x, y, z + radius * 0.9), radius * 0.6, stuff.wood, end_radius=radius * 0.12)
    builder.rod(middle - lean, middle + lean, radius * 0.06, stuff.brass)
    builder.ball(middle, radius, stuff.map, tint=builder.tone(0.2))


def _bust(builder: Builder, stuff: Stuff, x: float, y: float, yaw: float, base: float, size: float = 1.0) -> None:
    axes, tint = turned(yaw=yaw), builder.tone(0.12)
    builder.box((x, y, base / 2), (0.2, 0.2, base / 2), stuff.marble, axes=axes, bevel=0.03)
    foot, ahead, up = np.array([x, y, base]), axes[0] * size, axes[2] * size
    builder.rod(foot, foot + up * 0.1, 0.12 * size, stuff.marble, end_radius=0.07 * size, tint=tint)
    for place, half in (
        (up * 0.19, (0.11, 0.19, 0.12)),
        (up * 0.43, (0.12, 0.1, 0.14)),
        (ahead * 0.12 + up * 0.42, (0.035, 0.02, 0.035)),
    ):
        builder.ball(foot + place, np.array(half) * size, stuff.marble, axes=axes, tint=tint)


def _cat(builder: Builder, stuff: Stuff, place: Vector, yaw: float) -> None:
    axes = turned(yaw=yaw)
    foot, (ahead, aside, up) = np.asarray(place), axes
    builder.ball(foot + up * 0.14, (0.12, 0.09, 0.15), stuff.brass, axes=axes)
    builder.ball(foot + ahead * 0.06 + up * 0.31, 0.075, stuff.brass)
    for side in (-0.04, 0.04):
        ear = foot + ahead * 0.06 + aside * side + up * 0.36
        builder.rod(ear, ear + up * 0.07, 0.03, stuff.brass, end_radius=0.0)
    builder.rod(foot - ahead * 0.1 + up * 0.03, foot - ahead * 0.2 + aside * 0.12 + up * 0.03, 0.025, stuff.brass)


def _table(builder: Builder, generator: np.random.Generator, stuff: Stuff) -> None:
    axes = turned(yaw=12)
    ahead, _, up = axes
    baize = builder.material(materials.cloth(generator, palette("2f6a44", "3c7a4c", "285c3c", "8a2a28"), 9), 1.6)
    builder.box(up * (TABLE_TOP - 0.04), (1.15, 0.72, 0.04), stuff.wood, axes=axes, bevel=0.02)
    builder.box(up * TABLE_TOP, (0.98, 0.56, 0.008), baize, axes=axes)
    builder.box(up * 0.2, (0.85, 0.06, 0.05), stuff.wood, axes=axes)
    for end in (-0.8, 0.8):
        builder.box(ahead * end + up * 0.35, (0.08, 0.45, 0.33), stuff.wood, axes=axes, tint=builder.tone(0.2))
    for x, y, yaw in ((0.75, 0.12, 15), (-0.05, -0.42, 100), (-0.8, -0.2, 190), (0.05, 0.45, 260)):
        _open_book(builder, stuff, (x, y, TABLE_TOP + 0.025), yaw)
    for x, y, count in ((0.45, -0.35, 5), (-0.45, -0.5, 3), (-0.6, 0.28, 4), (0.62, 0.58, 3)):
        _stack(builder, stuff, (x, y, TABLE_TOP + 0.008), count)
    _globe(builder, stuff, 0.02, 0.02, TABLE_TOP, 0.2)
    _lamp(builder, stuff, 0.42, 0.22, TABLE_TOP)
    _lamp(builder, stuff, -0.42, -0.12, TABLE_TOP, 0.4)
    for x, y, height in ((0.95, -0.2, 0.22), (0.84, -0.32, 0.14), (-0.95, 0.2, 0.2)):
        _candlestick(builder, stuff, x, y, TABLE_TOP, height)
    for angle, distance, color in ((12, 1.6, 0), (100, 1.15, 1), (195, 1.6, 2), (275, 1.15, 0), (300, 1.3, 4)):
        _chair(builder, stuff, angle, distance, COVERS[color] * 1.2)


def _chair(builder: Builder, stuff: Stuff, angle: float, distance: float, cushion: Vector) -> None:
    """A chair that faces the centre of the room."""
    axes = turned(yaw=angle + builder.generator.uniform(-12, 12))
    back, aside, up = axes
    middle = turned(yaw=angle)[0] * distance
    builder.box(middle + up * 0.43, (0.2, 0.2, 0.04), stuff.leather, axes=axes, bevel=0.02, tint=cushion)
    builder.box(middle + back * 0.2 + up * 0.78, (0.025, 0.19, 0.14), stuff.leather, axes=axes, tint=cushion)
    for side in (-0.18, 0.18):
        foot = middle + aside * side
        builder.rod(foot + back * 0.2, foot + back * 0.2 + up * 0.96, 0.024, stuff.wood)
        builder.rod(foot - back * 0.17, foot - back * 0.17 + up * 0.4, 0.024, stuff.wood)


def _chandelier(builder: Builder, stuff: Stuff) -> None:
    builder.rod((0, 0, 2.0), (0, 0, CEILING), 0.02, stuff.brass)
    builder.ball((0, 0, 2.0), (0.09, 0.09, 0.13), stuff.brass)
    for angle in 0.2 + 0.4 * np.pi * np.arange(5):
        tip = np.array([0.48 * np.cos(angle), 0.48 * np.sin(angle), 2.06])
        builder.rod((0, 0, 1.98), tip, 0.022, stuff.brass)
        builder.rod(tip, tip + np.array([0, 0, 0.05]), 0.03, stuff.brass, end_radius=0.07)
        builder.rod(tip, tip + np.array([0, 0, 0.19]), 0.028, stuff.marble)
    builder.lamp((0, 0, 2.5), (0.42, 0.3, 0.16), 3.0)


def _furniture(builder: Builder, stuff: Stuff) -> None:
    """Furniture around the table, inside the camera path."""
    _globe(builder, stuff, -1.75, 1.5, 0.03, 0.33)
    for x, y, yaw, base in ((1.75, 1.2, 215, 0.7), (-2.05, -1.05, 30, 0.6), (0.7, -2.2, 100, 0.45)):
        _bust(builder, stuff, x, y, yaw, base)
    for x, y, yaw, number in ((1.95, -1.15, 62, 0), (-0.75, 2.1, 20, 1)):
        patch = (0.6 * number, (3 * number + 0.1) / SHELF_ROWS + 0.31 / stuff.low_cases.extent)
        builder.box((x, y, 0.33), (0.5, 0.17, 0.31), stuff.low_cases, axes=turned(yaw=yaw), patch=patch)
        for height in (0.02, 0.66):
            builder.box((x, y, height), (0.55, 0.2, 0.025), stuff.wood, axes=turned(yaw=yaw), bevel=0.01)
    _cat(builder, stuff, (1.95, -1.15, 0.685), 160)
    _stack(builder, stuff, (-0.5, 2.2, 0.685), 2)
    _open_book(builder, stuff, (-0.85, 2.06, 0.71), 80, 0.17)
    _lamp(builder, stuff, -1.12, 1.97, 0.685)
    builder.rod((-1.35, -1.95, 0), (-1.35, -1.95, 0.75), 0.14, stuff.wood, end_radius=0.05)
    _open_book(builder, stuff, (-1.35, -1.95, 0.82), 235, 0.27, slope=25)
    for x, y, half, yaw in ((1.3, 2.25, 0.2, 20), (-2.4, 0.35, 0.22, 50), (2.55, 0.1, 0.17, 70)):
        size, tint = (half, half * 1.3, half), builder.tone(0.3)
        builder.box((x, y, half), size, stuff.wood, axes=turned(yaw=yaw), bevel=0.02, tint=tint)
        _stack(builder, stuff, (x, y, 2 * half), 2, 0.19)
    for x, y, count in ((1.5, -2.05, 5), (-0.5, -2.2, 4), (-2.5, -0.35, 3), (2.3, 0.75, 5), (0.55, 2.1, 4)):
        _stack(builder, stuff, (x, y, 0.02), count, 0.2)
    for x, y, lean in ((-2.05, 0.95, 0.1), (-2.0, 0.85, -0.08), (-2.1, 0.85, 0.02)):
        builder.rod((x, y, 0.1), (x + lean, y - lean, 0.7), 0.035, stuff.paper)
    builder.rod((-2.05, 0.9, 0), (-2.05, 0.9, 0.42), 0.13, stuff.leather, end_radius=0.17, tint=COVERS[4])


def _corners(builder: Builder, stuff: Stuff) -> None:
    """Ladders, busts and lamps along the walls, outside the camera path."""
    for number, shift in enumerate((2.0, -3.1, 0.6, -2.2)):
        outward, aside, up = turned(yaw=90 * number)
        x, y, _ = 5.1 * outward + 4.6 * aside
        _bust(builder, stuff, x, y, 90 * number + 225, 1.0, 1.3)
        builder.lamp(4.8 * outward - shift * aside + 2.9 * up, (0.6, 0.42, 0.23), 2.4)
        foot, lean = outward * 5.15 + aside * shift, outward * 0.4 + up * 3.0
        for rail in (-0.2, 0.2):
            builder.rod(foot + aside * rail, foot + aside * rail + lean, 0.035, stuff.wood)
        for part in (0.15, 0.32, 0.49, 0.66, 0.83):
            middle = foot + lean * part
            builder.rod(middle - aside * 0.2, middle + aside * 0.2, 0.025, stuff.wood)
