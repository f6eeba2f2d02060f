"""A sunny courtyard: a tiled fountain, columns, a market stall, pots and barrels, old brick walls and a blue sky."""

from __future__ import annotations

import numpy as np

from stages.tracing import materials
from stages.tracing.patterns import palette, rgb
from stages.tracing.world import Builder, Material, Sky, World, turned

WALL = 6.3


def build(seed: int) -> World:
    """Build the courtyard; `seed` determines textures, tones and small displacements."""
    generator = np.random.default_rng([seed, 1])
    builder = Builder(generator)
    stone = builder.material(materials.mottled(generator, rgb("8a7354"), rgb("e2cfa4"), 6), 2.2)
    clay = builder.material(materials.mottled(generator, rgb("8e3f22"), rgb("d98a56"), 8), 1.5)
    wood = builder.material(materials.planks(generator, palette("8a5a30", "a06c3c", "6d4526", "b48450"), 9, 2), 1.3)
    blue_wood = builder.material(materials.planks(generator, palette("2f6f8c", "3f86a0", "275a78"), 10, 1), 1.4)
    glaze = builder.material(
        materials.mosaic(generator, palette("1d4e9e", "2f7fc4", "e0a526", "1b7f76", "c8502e"), rgb("f2ecdc"), 8),
        1.9,
        gloss=0.5,
    )
    water = builder.material(materials.mottled(generator, rgb("1c6f7c"), rgb("8fd6cf"), 12), 1.4, gloss=0.8)
    green = builder.material(materials.leaves(generator, palette("2f6b28", "4a8c32", "7fb04a", "26532a")), 1.0)
    bloom = palette("e0457c", "f4a020", "f6e6f0", "c81e3c")
    flowers = builder.material(materials.leaves(generator, palette("2f6b28", "4f8c38", "77a848"), 40, bloom), 1.0)
    _surround(builder, generator, stone, blue_wood, flowers)
    _fountain(builder, stone, glaze, water)
    _columns(builder, stone, clay, green)
    _stall(builder, generator, wood, clay, green)
    _pots(builder, clay, green, flowers)
    _barrels_and_crates(builder, wood, stone)
    builder.sun((0.55, 0.35, 0.76), (1.25, 1.1, 0.85))
    return builder.world(Sky(above=(0.42, 0.52, 0.7), below=(0.16, 0.13, 0.09)))


def _surround(
    builder: Builder, generator: np.random.Generator, stone: Material, shutter: Material, flowers: Material
) -> None:
    ground = materials.cobbles(generator, palette("9c8a70", "b8a584", "85705a", "a89a8c", "c4a67c"), rgb("4c4034"), 51)
    paving = builder.material(ground, 9.0)
    brick_colors = palette("b4623c", "c87f50", "9c4c30", "d09a6a", "a85a44")
    # One page for all four walls, no part of it shown twice: structure from motion would confuse walls that look alike.
    brick = builder.material(materials.bricks(generator, brick_colors, rgb("cdbb98"), 108, 40), 13.2)
    roof = builder.material(
        materials.bricks(generator, palette("c05a30", "a8452a", "d87c48"), rgb("4a2016"), 22, 22), 3.0
    )
    sky = builder.material(materials.clouds(generator, rgb("3f7fd0"), rgb("b4d8f0"), rgb("ffffff")), 80.0, glow=1.0)
    builder.ball((0, 0, 0), 14.0, sky, patch=(0.5, 0.5), casts_shadow=False)
    builder.box((0, 0, -0.5), (9, 9, 0.5), paving, casts_shadow=False)
    for side in range(4):
        axes = turned(yaw=90 * side)
        outward, sideways, up = axes
        height = (2.9, 2.3, 3.3, 2.6)[side]
        middle = outward * WALL
        half, patch = (0.25, 6.6, height / 2), (0.0, side / 4)
        builder.box(middle + up * height / 2, half, brick, axes=axes, patch=patch, casts_shadow=False)
        eave = turned(yaw=90 * side, pitch=28)
        builder.box(
            middle + outward * 0.2 + up * (height + 0.25), (0.75, 6.6, 0.06), roof, axes=eave, casts_shadow=False
        )
        for number, offset in enumerate((-4.4, -2.2, 0.0, 2.2, 4.4)):
            face = middle - outward * 0.27 + sideways * (offset + generator.uniform(-0.2, 0.2))
            if (number + side) % 3 == 0:
                builder.box(face + up * 0.85, (0.1, 0.5, 0.85), stone, axes=axes)
                builder.box(
                    face - outward * 0.06 + up * 0.78, (0.08, 0.38, 0.74), shutter, axes=axes, tint=builder.tone(0.4)
                )
                continue
            builder.box(face + up * 1.55, (0.06, 0.42, 0.5), stone, axes=axes)
            tint = builder.tone(0.5)
            builder.box(face - outward * 0.03 + up * 1.55, (0.07, 0.33, 0.42), shutter, axes=axes, tint=tint)
            builder.box(face - outward * 0.15 + up * 0.95, (0.16, 0.45, 0.09), stone, axes=axes)
            for shift in (-0.25, 0.02, 0.27):
                place = face - outward * 0.17 + sideways * shift + up * 1.08
                builder.ball(place, generator.uniform(0.13, 0.2), flowers, tint=builder.tone())
    builder.rod((-7.6, -7.4, 0), (-7.6, -7.4, 4.6), 1.3, brick, casts_shadow=False)
    builder.rod((-7.6, -7.4, 4.6), (-7.6, -7.4, 6.2), 1.5, roof, end_radius=0.0, casts_shadow=False)
    builder.rod((7.8, -7.6, 0), (7.8, -7.6, 3.9), 1.0, stone, casts_shadow=False)
    builder.rod((7.8, -7.6, 3.9), (7.8, -7.6, 5.0), 1.2, roof, end_radius=0.0, casts_shadow=False)


def _fountain(builder: Builder, stone: Material, glaze: Material, water: Material) -> None:
    builder.rod((0, 0, 0), (0, 0, 0.08), 1.35, glaze)
    builder.rod((0, 0, 0.08), (0, 0, 0.44), 0.95, glaze)
    builder.rod((0, 0, 0.43), (0, 0, 0.455), 0.93, water)
    for number in range(18):
        angle = 2 * np.pi * number / 18
        place = (0.95 * np.cos(angle), 0.95 * np.sin(angle), 0.47)
        axes = turned(yaw=np.degrees(angle))
        builder.box(place, (0.09, 0.155, 0.055), stone, axes=axes, bevel=0.02, tint=builder.tone(0.2))
    builder.rod((0, 0, 0.4), (0, 0, 0.6), 0.26, stone, end_radius=0.14)
    builder.rod((0, 0, 0.6), (0, 0, 1.0), 0.12, glaze)
    builder.rod((0, 0, 1.0), (0, 0, 1.2), 0.14, stone, end_radius=0.55)
    builder.rod((0, 0, 1.2), (0, 0, 1.22), 0.5, water)
    builder.rod((0, 0, 1.2), (0, 0, 1.5), 0.09, stone, end_radius=0.07)
    builder.rod((0, 0, 1.5), (0, 0, 1.6), 0.08, stone, end_radius=0.26)
    builder.ball((0, 0, 1.72), 0.15, glaze)
    builder.rod((0, 0, 1.8), (0, 0, 2.1), 0.07, stone, end_radius=0.0)


def _columns(builder: Builder, stone: Material, clay: Material, green: Material) -> None:
    for angle, height in ((20, 1.75), (112, 0.8), (205, 1.9), (290, 0.7)):
        x, y = 2.35 * np.cos(np.radians(angle)), 2.35 * np.sin(np.radians(angle))
        builder.box((x, y, 0.09), (0.24, 0.24, 0.09), stone, axes=turned(yaw=angle), bevel=0.03)
        builder.rod((x, y, 0.18), (x, y, 0.26), 0.2, stone, end_radius=0.15)
        builder.rod((x, y, 0.26), (x, y, height), 0.135, stone, end_radius=0.115, tint=builder.tone())
        if height > 1.0:
            builder.rod((x, y, height), (x, y, height + 0.1), 0.12, stone, end_radius=0.2)
            builder.box((x, y, height + 0.13), (0.21, 0.21, 0.035), stone, axes=turned(yaw=angle))
            builder.rod((x, y, height + 0.16), (x, y, height + 0.32), 0.1, clay, end_radius=0.17)
            builder.ball((x, y, height + 0.42), (0.22, 0.22, 0.17), green)
        else:
            builder.rod((x + 0.45, y + 0.5, 0.13), (x - 0.1, y + 0.95, 0.13), 0.13, stone)


def _stall(builder: Builder, generator: np.random.Generator, wood: Material, clay: Material, green: Material) -> None:
    awning = builder.material(materials.cloth(generator, palette("c8322c", "f2e8d4", "e8b838", "f2e8d4"), 12), 1.8)
    middle, turn = np.array([-1.75, 1.45, 0.0]), turned(yaw=140)
    forward, sideways, up = turn
    builder.box(middle + up * 0.34, (0.32, 0.75, 0.34), wood, axes=turn)
    builder.box(middle + up * 0.7, (0.4, 0.85, 0.03), wood, axes=turn)
    for front in (-0.38, 0.38):
        for side in (-0.8, 0.8):
            foot = middle + forward * front + sideways * side
            builder.rod(foot, foot + up * (1.45 + 0.3 * front), 0.03, wood)
    builder.box(middle + up * 1.47, (0.55, 0.95, 0.02), awning, axes=turned(yaw=140, pitch=-17))
    fruit = palette("e8962a", "c8283c", "8cae3a", "e6c83c", "7a3c78")
    for number in range(15):
        place = middle + forward * (0.12 * (number % 3) - 0.1) + sideways * (0.145 * (number // 3) - 0.3) + up * 0.8
        builder.ball(place, 0.075, clay if number % 5 else green, tint=fruit[number // 3] * 1.6)
    builder.box(middle + sideways * 0.6 + up * 0.8, (0.14, 0.12, 0.08), wood, axes=turn)


def _pots(builder: Builder, clay: Material, green: Material, flowers: Material) -> None:
    for number, (angle, radius, size) in enumerate(
        (
            (60, 1.8, 0.24),
            (75, 2.35, 0.32),
            (160, 2.75, 0.3),
            (235, 1.65, 0.2),
            (250, 2.5, 0.34),
            (330, 2.7, 0.3),
            (345, 1.7, 0.2),
        )
    ):
        x, y = radius * np.cos(np.radians(angle)), radius * np.sin(np.radians(angle))
        tint = builder.tone(0.25)
        builder.rod((x, y, 0), (x, y, size), 0.55 * size, clay, end_radius=0.8 * size, tint=tint)
        builder.rod((x, y, size), (x, y, size * 1.25), 0.9 * size, clay, tint=tint)
        plant = flowers if number % 2 else green
        for _ in range(5):
            shift = builder.generator.uniform(-0.55, 0.55, 3) * size
            reach = size * builder.generator.uniform(0.5, 0.8)
            place = (x + shift[0], y + shift[1], size * 1.7 + shift[2])
            builder.ball(place, (reach, reach, 0.85 * reach), plant, tint=builder.tone())


def _barrels_and_crates(builder: Builder, wood: Material, stone: Material) -> None:
    for x, y, height in ((1.55, -1.75, 0.62), (2.05, -1.45, 0.5), (-2.3, -0.6, 0.6)):
        middle = height / 2
        builder.rod((x, y, 0), (x, y, middle), 0.2, wood, end_radius=0.25, tint=builder.tone())
        builder.rod((x, y, middle), (x, y, height), 0.25, wood, end_radius=0.2, tint=builder.tone())
        for part in (0.15, 0.85):
            builder.rod((x, y, height * part - 0.02), (x, y, height * part + 0.02), 0.235, stone, tint=(0.3, 0.3, 0.34))
    for x, y, z, half, yaw in (
        (0.75, -2.3, 0.2, 0.2, 15),
        (0.72, -2.28, 0.54, 0.14, 40),
        (1.15, -2.5, 0.15, 0.15, 60),
        (1.9, 1.75, 0.22, 0.22, 33),
    ):
        builder.box((x, y, z), (half, half, half), wood, axes=turned(yaw=yaw), bevel=0.02, tint=builder.tone(0.25))
    bench = turned(yaw=55)
    _, sideways, up = bench
    seat = np.array([0.2, 2.4, 0.0])
    builder.box(seat + up * 0.38, (0.2, 0.7, 0.035), wood, axes=bench)
    for side in (-0.5, 0.5):
        builder.box(seat + sideways * side + up * 0.17, (0.16, 0.06, 0.17), stone, axes=bench)
