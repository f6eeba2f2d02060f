"""A coral reef under water: a mountain of corals, a sunken chest and an amphora, fish, cliffs and rippled sand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.tracing import materials
from stages.tracing.patterns import Field, Page, fractal, mix, noise, palette, relief, rgb, shade, step, stones, warp
from stages.tracing.world import PAGE_SIZE as SIZE
from stages.tracing.world import Builder, Material, Sky, World, along, turned

CLIFF = 6.4
FISH_DESIGNS = 3
"""Fish designs along each side of their texture page, which holds `FISH_DESIGNS`²."""

FISH_THICKNESS = 0.5
"""Thickness of a fish over its height."""


def build(seed: int) -> World:
    """Build the reef; `seed` determines textures, tones and small displacements."""
    generator = np.random.default_rng([seed, 3])
    builder = Builder(generator)
    crust = palette("f0762e", "e8508c", "9a5ad0", "f0c83c", "2fb0a0", "58b868")
    rock = builder.material(_encrusted(generator, rgb("3a2a5c"), rgb("b07c94"), crust, 0.6), 2.6)
    brains = [
        builder.material(_meanders(generator, rgb("8c2f14"), rgb("ffae4c")), 1.3),
        builder.material(_meanders(generator, rgb("3c2272"), rgb("c49cf0")), 1.5),
    ]
    corals = [
        builder.material(_polyps(generator, palette("f0508c", "f87aa4", "d83474", "ffa0b4"), 44), 1.1),
        builder.material(_polyps(generator, palette("f4cc3c", "f0a828", "ffe27c", "c8c83c"), 36), 1.0),
        builder.material(_polyps(generator, palette("7c4cc8", "a078e4", "5c3ca8", "d078d8"), 52), 1.1),
    ]
    fan = builder.material(_network(generator, palette("ff5c6c", "f04cb0", "ff9848"), rgb("2c1040")), 0.9)
    _surround(builder, generator, crust, [*corals, *brains])
    _mountain(builder, rock, brains, corals)
    _fans_and_tubes(builder, fan, corals)
    _staghorns(builder, corals)
    _anemones(builder, corals, brains)
    _treasure(builder, generator)
    _bottom(builder, rock, brains, corals)
    _fish(builder, builder.material(_fish_designs(generator), 1.0, gloss=0.45))
    builder.sun((0.35, -0.4, 0.85), (0.9, 1.0, 0.88))
    builder.lamp((-2.4, -2.2, 2.4), (0.15, 0.75, 0.85), 1.6)
    builder.lamp((2.6, 1.2, 1.5), (0.8, 0.15, 0.6), 1.3)
    builder.lamp((-1.2, 2.6, 1.3), (0.9, 0.5, 0.1), 1.3)
    return builder.world(Sky(above=(0.34, 0.55, 0.66), below=(0.12, 0.2, 0.28)))


def _ripples_of_light(generator: np.random.Generator, count: int) -> Field:
    """Caustics: the bright net of light that waves cast on the sea floor."""
    inset = warp(stones(SIZE, count, generator).inset * count, 0.03, 9, generator)
    return np.maximum(1 - step(inset, 0.0, 0.14), 0.45 * (1 - step(inset, 0.0, 0.4)))


def _sand(generator: np.random.Generator, pebbles: np.ndarray) -> Page:
    """Rippled sand under caustics, strewn with pebbles and bits of shell."""
    down = (np.arange(SIZE, dtype=np.float32) / SIZE)[:, None]
    bend = fractal(SIZE, 4, generator, octaves=3)
    ripple = 0.5 + 0.5 * np.sin(2 * np.pi * 26 * down + 9 * bend + 2 * noise(SIZE, 16, generator)).astype(np.float32)
    grain = fractal(SIZE, 64, generator, octaves=4, gain=0.9)
    tone = 0.45 * ripple + 0.3 * grain + 0.25 * fractal(SIZE, 3, generator, octaves=6)
    picture = shade(mix(rgb("0c4c78"), rgb("6cc4b8"), step(tone, 0.1, 0.95)), 0.75 + 0.4 * grain)
    for count, share in ((40, 0.22), (90, 0.2)):
        bed = stones(SIZE, count, generator, regularity=0.2)
        dome = step(bed.inset * count, 0.1, 0.4)
        body = (step(bed.inset * count, 0.12, 0.17) * (bed.tone(generator) < share * 2 * bend)).astype(np.float32)
        pebble = shade(bed.color(pebbles, generator), (0.5 + 0.5 * dome) * (0.75 + 0.4 * grain) * relief(dome, 2.0))
        picture = mix(picture, pebble, body)
    return mix(picture, rgb("b4f4e4"), 0.55 * _ripples_of_light(generator, 15))


def _encrusted(
    generator: np.random.Generator, dark: np.ndarray, bright: np.ndarray, crust: np.ndarray, share: float
) -> Page:
    """Cracked rock with colonies of corals and algae in the colours `crust`; `share` sets how much is overgrown."""
    picture = materials.mottled(generator, dark, bright, 7, rough=1.0)
    cracks = warp(stones(SIZE, 9, generator).inset, 0.06, 8, generator) * 9
    picture = shade(picture, (0.45 + 0.55 * step(cracks, 0.0, 0.06)) * relief(fractal(SIZE, 24, generator), 2.0))
    for count in (17, 42):
        colonies = stones(SIZE, count, generator)
        inset = (colonies.inset + 0.03 * (fractal(SIZE, 24, generator, octaves=4) - 0.5)) * count
        body = step(inset, 0.02, 0.08) * (colonies.tone(generator) < share * fractal(SIZE, 5, generator, octaves=3))
        spots = fractal(SIZE, 90, generator, octaves=3, gain=0.9)
        growth = shade(colonies.color(crust, generator), 0.4 + 0.35 * step(inset, 0.0, 0.4) + 0.5 * spots)
        picture = mix(picture, growth, body.astype(np.float32))
    return shade(picture, 0.7 + 0.45 * fractal(SIZE, 3, generator, octaves=5))


def _meanders(generator: np.random.Generator, valley: np.ndarray, ridge: np.ndarray) -> Page:
    """The winding folds of a brain coral."""
    field = warp(fractal(SIZE, 8, generator, octaves=3, gain=0.45), 0.03, 10, generator)
    folds = (0.5 + 0.5 * np.sin(64 * field)).astype(np.float32)
    grain = fractal(SIZE, 64, generator, octaves=4, gain=0.9)
    picture = shade(mix(valley, ridge, step(folds, 0.2, 0.75)), 0.7 + 0.45 * grain)
    return shade(picture, 0.7 + 0.4 * fractal(SIZE, 4, generator, octaves=5))


def _polyps(generator: np.random.Generator, colors: np.ndarray, count: int) -> Page:
    """Coral made of many small cups, bright at the rim and dark at the mouth."""
    cups = stones(SIZE, count, generator, regularity=0.3)
    inset = cups.inset * count
    rim = step(inset, 0.0, 0.16) - 0.7 * step(inset, 0.24, 0.4)
    grain = fractal(SIZE, 64, generator, octaves=4, gain=0.9)
    picture = shade(cups.color(colors, generator), 0.35 + 0.5 * rim + 0.3 * cups.tone(generator) + 0.25 * grain)
    return shade(picture, 0.65 + 0.5 * fractal(SIZE, 4, generator, octaves=5))


def _network(generator: np.random.Generator, colors: np.ndarray, behind: np.ndarray) -> Page:
    """The coarse and fine veins of a sea fan, over a dark background."""
    picture = behind * (0.6 + 0.8 * fractal(SIZE, 40, generator, octaves=4)[..., None])
    for count, width in ((40, 0.06), (15, 0.05)):
        cells = stones(SIZE, count, generator)
        vein = 1 - step(warp(cells.inset, 0.015, 20, generator) * count, width, width + 0.06)
        tone = 0.6 + 0.45 * fractal(SIZE, 30, generator, octaves=4)
        picture = mix(picture, shade(colors[generator.integers(3)] * np.ones((SIZE, SIZE, 3)), tone), vein)
    return picture


def _fish_designs(generator: np.random.Generator) -> Page:
    """A page of fish skins, each with its own stripes, scales and eyes, unrolled about the mouth at its centre."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE * FISH_DESIGNS
    cell = place.astype(np.int64)
    design = cell[:, None] * FISH_DESIGNS + cell[None, :]
    side = np.broadcast_to(2 * (place % 1) - 1, (SIZE, SIZE))
    up, from_mouth = -side.T, np.hypot(side / FISH_THICKNESS, side.T)
    x, y = np.cos(np.pi * from_mouth), np.sin(np.pi * np.minimum(from_mouth, 1)) * up / from_mouth
    colors = palette("ff7a1c", "ffd834", "2c6cf0", "f04c9c", "f6f2e4", "7c3cd0", "20c8c0", "ff4c3c")
    first, second, third, face = (colors[generator.permutation(9) % 8][design] for _ in range(4))
    pick = generator.random((3, FISH_DESIGNS**2), dtype=np.float32)[:, design]
    wave = np.sin((6 + 8 * pick[0]) * (x + 0.8 * (pick[1] - 0.5) * y) + 6 * pick[2])
    scales = stones(SIZE, 100, generator, regularity=0.5)
    picture = mix(mix(first, second, step(y, -0.2, 0.1)), third, step(wave, 0.2, 0.4))
    picture = mix(picture, face, step(x, 0.6, 0.64))
    picture = shade(picture, 0.65 + 0.25 * step(scales.inset * 100, 0.0, 0.3) + 0.25 * scales.tone(generator))
    to_eye = np.hypot(x - 0.72, 0.6 * (y - 0.2))
    picture = mix(picture, rgb("fff8e0"), 1 - step(to_eye, 0.09, 0.11))
    return mix(picture, rgb("081018"), 1 - step(to_eye, 0.045, 0.065))


def _water(generator: np.random.Generator) -> Page:
    """Water overhead, for a dome: bright at the centre of the page, deep blue at the horizon, with caustics."""
    place = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / SIZE - np.float32(0.5)
    distance = np.hypot(place[:, None], place[None, :])
    water = mix(rgb("8ff0e0"), rgb("12669c"), step(distance, 0.05, 0.42))
    water = shade(water, 0.55 + 0.65 * fractal(SIZE, 12, generator, octaves=6, gain=0.8))
    return mix(water, rgb("7ff4e4"), 0.5 * _ripples_of_light(generator, 26) * fractal(SIZE, 6, generator))


def _at(angle: float, radius: float, height: float = 0.0) -> np.ndarray:
    """The point [3] at cylindrical coordinates about the reef's axis; `angle` in degrees."""
    return np.array([radius * np.cos(np.radians(angle)), radius * np.sin(np.radians(angle)), height])


def _surround(builder: Builder, generator: np.random.Generator, crust: np.ndarray, growth: list[Material]) -> None:
    sand = builder.material(_sand(generator, palette("d88a60", "e8dcc8", "8c6cb4", "3c6c8c", "f0a8a8")), 4.6)
    cliff = builder.material(_encrusted(generator, rgb("0e3460"), rgb("4c9ab4"), crust, 0.65), 4.2)
    builder.ball(
        (0, 0, 0), 14.0, builder.material(_water(generator), 46.0, glow=1.0), patch=(0.5, 0.5), casts_shadow=False
    )
    builder.box((0, 0, -0.5), (9, 9, 0.5), sand, casts_shadow=False)
    for side in range(4):
        axes = turned(yaw=90 * side)
        outward, sideways, up = axes
        facing, height = np.stack([-sideways, up, -outward]), (1.7, 2.2, 1.5, 2.0)[side]
        middle = outward * CLIFF
        builder.box(middle + up * height / 2, (0.4, 7.0, height / 2), cliff, axes=axes, casts_shadow=False)
        for offset in (-5.4, -3.3, -1.2, 1.0, 3.1, 5.2):
            reach = generator.uniform((1.0, 1.0, 0.5), (1.5, 1.7, 0.9))
            centre = middle + sideways * offset + outward * (reach[2] - 0.9) + up * generator.uniform(0.2, 0.9) * height
            builder.ball(centre, reach, cliff, axes=facing, tint=builder.tone(0.3), casts_shadow=False)
            plant = growth[generator.integers(len(growth))]
            place = middle - outward * generator.uniform(0.4, 0.5) + sideways * (offset + generator.uniform(0.6, 1.3))
            builder.ball(
                place + up * generator.uniform(0.1, 1.4), generator.uniform(0.2, 0.42, 3), plant, tint=builder.tone(0.3)
            )


def _mountain(builder: Builder, rock: Material, brains: list[Material], corals: list[Material]) -> None:
    for angle, radius, height, half in (
        (0, 0.0, 0.35, (0.95, 0.85, 0.75)),
        (40, 0.35, 0.95, (0.5, 0.45, 0.5)),
        (150, 0.7, 0.3, (0.6, 0.7, 0.5)),
        (265, 0.75, 0.25, (0.65, 0.55, 0.5)),
        (330, 0.95, 0.2, (0.5, 0.6, 0.4)),
        (70, 1.0, 0.15, (0.55, 0.5, 0.4)),
    ):
        builder.ball(_at(angle, radius, height), half, rock, axes=turned(yaw=angle), tint=builder.tone(0.2))
    for number, (angle, radius, height, size) in enumerate(
        ((10, 0.95, 0.62, 0.3), (195, 0.95, 0.72, 0.33), (105, 0.75, 0.75, 0.27), (285, 1.15, 0.45, 0.28))
    ):
        builder.ball(_at(angle, radius, height), (size, size, 0.8 * size), brains[number % 2], tint=builder.tone(0.2))
    for number in range(14):
        size = builder.generator.uniform(0.1, 0.2)
        place = _at(26 * number + 12, 1.25 - 0.25 * (number % 3), 0.42 + 0.2 * (number % 3))
        builder.ball(place, (size, size, 0.8 * size), corals[number % 3], tint=builder.tone(0.35))
    for angle, radius, height, reach in ((60, 0.1, 1.5, 0.42), (235, 0.75, 0.95, 0.4), (345, 0.6, 1.15, 0.34)):
        place, up = _at(angle, radius, height), np.array([0, 0, 1.0])
        builder.rod(place - 0.25 * up, place, 0.07, corals[0], end_radius=0.5 * reach)
        plate = corals[angle % 2 + 1]
        builder.rod(place, place + 0.05 * up, reach * 0.9, plate, end_radius=reach, tint=builder.tone(0.2))


def _fans_and_tubes(builder: Builder, fan: Material, corals: list[Material]) -> None:
    for angle, radius, height, reach in ((85, 0.55, 1.3, 0.36), (170, 1.25, 0.85, 0.34), (310, 1.25, 0.8, 0.4)):
        place, axes = _at(angle, radius, height), along(_at(angle + builder.generator.uniform(-40, 40), 1.0, 0.1))
        builder.rod(place - (0, 0, reach + 0.2), place, 0.05, fan, end_radius=0.02)
        for lean, size in ((-0.75, 0.7), (0.0, 1.0), (0.75, 0.75)):
            lobe = place + reach * (
                lean * np.cross((0, 0, 1), axes[2]) + (0.25 - 0.3 * abs(lean)) * np.array([0, 0, 1])
            )
            builder.rod(lobe, lobe + 0.035 * axes[2], 0.75 * size * reach, fan, tint=builder.tone(0.3))
    for angle, radius, bottom, count, kind in ((215, 0.35, 0.9, 5, 2), (30, 1.35, 0.2, 5, 1), (130, 1.6, 0.0, 4, 0)):
        for number in range(count):
            foot = _at(angle, radius, bottom) + _at(72 * number, 0.13)
            stop = foot + _at(72 * number, 0.1, builder.generator.uniform(0.4, 0.75))
            wide = builder.generator.uniform(0.07, 0.1)
            builder.rod(foot, stop, 0.7 * wide, corals[kind], end_radius=wide, tint=builder.tone(0.25))
            lip = 0.012 * (stop - foot) / np.linalg.norm(stop - foot)
            builder.rod(stop - lip, stop + 0.3 * lip, 0.7 * wide, corals[kind], tint=(0.25, 0.2, 0.3))


def _staghorns(builder: Builder, corals: list[Material]) -> None:
    for angle, radius, bottom, kind in ((-35, 0.3, 1.05, 1), (55, 1.75, 0.0, 0), (240, 1.8, 0.0, 2)):
        for number in range(4):
            foot = _at(angle, radius, bottom) + _at(90 * number, 0.06)
            fork = foot + _at(
                90 * number + builder.generator.uniform(-30, 30), 0.17, builder.generator.uniform(0.28, 0.4)
            )
            tint = builder.tone(0.2)
            builder.rod(foot, fork, 0.06, corals[kind], end_radius=0.045, tint=tint)
            for turn in (-50, 50):
                tip = fork + _at(90 * number + turn, 0.15, builder.generator.uniform(0.18, 0.34))
                builder.rod(fork, tip, 0.045, corals[kind], end_radius=0.015, tint=tint)


def _anemones(builder: Builder, corals: list[Material], brains: list[Material]) -> None:
    for angle, radius, height, kind in ((345, 1.45, 0.42, 0), (185, 1.75, 0.12, 2)):
        middle = _at(angle, radius, height)
        builder.rod(middle - (0, 0, 0.25), middle, 0.12, brains[1 - kind // 2], end_radius=0.17)
        for number in range(9):
            lean = 0.05 + 0.13 * (number % 3) / 2
            start = middle + _at(131 * number, 0.8 * lean)
            stop = middle + _at(131 * number + 15, 2.0 * lean, builder.generator.uniform(0.2, 0.32))
            builder.rod(start, stop, 0.032, corals[kind], end_radius=0.016, tint=builder.tone(0.3))


def _treasure(builder: Builder, generator: np.random.Generator) -> None:
    wood = builder.material(materials.planks(generator, palette("2c6c74", "3c8480", "7c5c78", "245868"), 9, 2), 0.9)
    gold = builder.material(_polyps(generator, palette("f8d048", "ffe888", "e8a428"), 30), 0.8, gloss=0.8)
    glaze = palette("2454b8", "f08c3c", "38b8b0", "f4d05c")
    tiles = builder.material(materials.mosaic(generator, glaze, rgb("f0e4d0"), 9), 1.0, gloss=0.5)
    axes, middle = turned(yaw=-75, pitch=5, roll=6), _at(-70, 1.68, 0.0)
    forward, sideways, up = axes
    builder.box(middle + up * 0.15, (0.24, 0.38, 0.17), wood, axes=axes, bevel=0.02)
    builder.box(middle - forward * 0.3 + up * 0.48, (0.06, 0.39, 0.2), wood, axes=axes, bevel=0.02)
    for side in (-0.28, 0.28):
        builder.box(middle + sideways * side + up * 0.15, (0.25, 0.03, 0.175), gold, axes=axes, tint=(0.8, 0.75, 0.7))
    builder.ball(middle + up * 0.3, (0.21, 0.34, 0.1), gold, axes=axes)
    for number in range(16):
        spot = middle + up * 0.38 + forward * generator.uniform(-0.15, 0.15) + sideways * generator.uniform(-0.28, 0.28)
        if number >= 9:
            spot = middle * (1 + generator.uniform(0.17, 0.35)) + sideways * generator.uniform(-0.5, 0.5) + (0, 0, 0.03)
        tilt = 0.012 * np.array([generator.uniform(-0.6, 0.6), generator.uniform(-0.6, 0.6), 1.0])
        builder.rod(spot - tilt, spot + tilt, 0.07, gold, tint=builder.tone(0.2))
    foot, lean = _at(100, 2.0, 0.2), np.array([-0.75, 0.25, 0.35]) / 0.865
    builder.ball(foot, (0.24, 0.24, 0.36), tiles, axes=along(lean))
    builder.rod(foot + 0.28 * lean, foot + 0.52 * lean, 0.12, tiles, end_radius=0.08)
    builder.rod(foot + 0.52 * lean, foot + 0.58 * lean, 0.13, tiles)
    for aside in np.cross(lean, (0, 0, 1.0)) * [[0.24], [-0.24]]:
        builder.rod(foot + 0.5 * lean, foot + 0.36 * lean + aside, 0.025, tiles)
        builder.rod(foot + 0.36 * lean + aside, foot + 0.1 * lean + 0.9 * aside, 0.025, tiles)


def _bottom(builder: Builder, rock: Material, brains: list[Material], corals: list[Material]) -> None:
    for angle, radius, size in (
        (15, 2.15, 0.24),
        (150, 2.05, 0.26),
        (215, 2.1, 0.27),
        (320, 2.1, 0.2),
        (80, 1.55, 0.2),
    ):
        place = _at(angle, radius, 0.35 * size)
        builder.ball(place, (size, 0.8 * size, 0.7 * size), rock, axes=turned(yaw=2 * angle), tint=builder.tone(0.3))
        builder.ball(_at(angle + 9, radius - 0.1, 0.05), 0.13, brains[angle % 2], tint=builder.tone(0.3))
    for number, (angle, radius) in enumerate(((0, 1.75), (125, 2.4), (205, 2.6), (350, 2.55))):
        middle = _at(angle, radius, 0.05)
        for arm in range(5):
            tip = middle + _at(72 * arm + angle, 0.22, -0.03)
            builder.rod(middle, tip, 0.055, corals[number % 3], end_radius=0.012, tint=(1.0, 0.75, 0.6))
    for _ in range(12):
        place = _at(builder.generator.uniform(0, 360), builder.generator.uniform(2.3, 3.6))
        half = builder.generator.uniform((0.08, 0.06, 0.04), (0.14, 0.1, 0.07))
        yaw = turned(yaw=builder.generator.uniform(0, 360))
        builder.ball(place, half, corals[builder.generator.integers(3)], axes=yaw, tint=builder.tone(0.5))


def _fish(builder: Builder, designs: Material) -> None:
    """Fish circling the mountain, a school of small fish, and large fish along the cliffs."""
    circling = [(41.0 * n, 0.8 + 0.35 * (n % 4), 1.25 + 0.09 * (n % 11), 0.15) for n in range(14)]
    school = [(205 + 9.0 * (n % 5), 1.15 + 0.13 * (n % 4), 1.4 + n / 20, 0.09) for n in range(11)]
    outer = [(45.0 * n + 10, 5.2, 0.9 + 0.3 * (n % 3), 0.24) for n in range(8)]
    for angle, radius, height, size in circling + school + outer:
        length = size * builder.generator.uniform(0.85, 1.15)
        deep = builder.generator.uniform(0.42, 0.6) * length
        yaw = angle + 90 + builder.generator.uniform(-25, 25)
        forward, sideways, up = turned(yaw=yaw, pitch=builder.generator.uniform(-12, 12))
        axes, place, tint = np.stack([sideways, up, forward]), _at(angle, radius, height), builder.tone(0.15)
        skin = replace(designs, extent=2 * np.pi * FISH_DESIGNS * deep)
        patch = (builder.generator.integers(FISH_DESIGNS, size=2) + 0.5) / FISH_DESIGNS
        builder.ball(place, (FISH_THICKNESS * deep, deep, length), skin, axes=axes, patch=patch, tint=tint)
        tail = place - 1.12 * length * forward
        builder.ball(tail, (0.05 * length, 0.85 * deep, 0.2 * length), skin, axes=axes, patch=patch, tint=tint)
