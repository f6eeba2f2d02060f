"""A workshop: an old tractor, a motor on a stand, a bench with a vice, tools on the walls, drums, tyres and crates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.tracing import materials
from stages.tracing.group import Group
from stages.tracing.patterns import palette, rgb
from stages.tracing.workshop_surfaces import concrete, corrugated, machine_paint, packed_goods, pegboard, rubber
from stages.tracing.world import Builder, Material, Sky, Vector, World, turned

WALL = 6.2
CEILING = 4.7


@dataclass(frozen=True)
class Paints:
    """The materials that most objects in the workshop share."""

    red: Material
    yellow: Material
    cyan: Material
    grey: Material
    steel: Material
    rubber: Material
    wood: Material
    label: Material
    globe: Material


def build(seed: int) -> World:
    """Build the workshop; `seed` determines textures, tones and the goods on the shelves."""
    generator = np.random.default_rng([seed, 4])
    builder = Builder(generator)
    paints = Paints(
        red=builder.material(machine_paint(generator, rgb("cc3428")), 1.5, gloss=0.25),
        yellow=builder.material(machine_paint(generator, rgb("edb91e")), 1.4, gloss=0.2),
        cyan=builder.material(machine_paint(generator, rgb("22a3b8")), 1.5, gloss=0.25),
        grey=builder.material(machine_paint(generator, rgb("a4abae")), 1.3, gloss=0.15),
        steel=builder.material(
            materials.mottled(generator, rgb("6c747a"), rgb("bcc4c8"), 28, rough=0.9), 0.8, gloss=0.25
        ),
        rubber=builder.material(rubber(generator), 0.9),
        wood=builder.material(materials.planks(generator, palette("a88a60", "c2a878", "8c7450"), 8, 2), 1.0),
        label=builder.material(packed_goods(generator, 4, 7), 1.3, gloss=0.15),
        globe=builder.material(
            materials.mottled(generator, rgb("e0c48c"), rgb("fff4d8"), 10), 0.7, gloss=0.4, glow=0.75
        ),
    )
    _room(builder, generator, paints)
    _walls(builder, generator, paints)
    _tractor(Group.on_floor(builder, 0.05, 0.0, 25), paints)
    _bench(Group.on_floor(builder, -1.4, 1.15, 140), paints)
    _motor(Group.on_floor(builder, 1.05, -1.5, -50), paints)
    _cabinet(Group.on_floor(builder, -1.05, -1.68, 235), paints)
    _stores(Group.on_floor(builder, 0.0, 0.0, 0), paints)
    _ladder(Group.on_floor(builder, 0.45, 1.85, 75), paints)
    builder.sun((-0.3, 0.42, 0.86), (1.5, 1.36, 1.1))
    builder.lamp((-1.9, 0.5, 1.9), (0.75, 0.55, 0.3), 1.6)
    builder.lamp((2.0, -0.6, 2.0), (0.65, 0.5, 0.32), 1.6)
    for x, y in ((4.5, 0.5), (-2.5, 4.0), (-2.5, -4.0)):
        builder.lamp((x, y, 3.0), (0.42, 0.43, 0.44), 3.0)
    return builder.world(Sky(above=(0.27, 0.33, 0.4), below=(0.11, 0.11, 0.115)))


def _room(builder: Builder, generator: np.random.Generator, paints: Paints) -> None:
    floor = builder.material(concrete(generator), 5.3)
    roof = builder.material(corrugated(generator, palette("6c7276", "80878a", "5e666c"), 22), 3.0)
    pane = builder.material(materials.mottled(generator, rgb("8cc4e0"), rgb("f0fafc"), 6), 2.0, glow=1.0)
    builder.box((0, 0, -0.5), (9, 9, 0.5), floor, casts_shadow=False)
    builder.box((0, 0, CEILING + 0.2), (8, 8, 0.2), roof, casts_shadow=False)
    for x, y in ((-3.4, 0.0), (0.0, 0.6), (3.4, -0.4)):
        builder.box((x, y, CEILING), (0.8, 1.9, 0.03), pane, casts_shadow=False)
    for number, x in enumerate((-5.2, -3.3, -1.4, 0.5, 2.4, 4.3)):
        builder.box((x, 0, CEILING - 0.2), (0.11, 6.0, 0.15), (paints.grey, paints.cyan)[number % 2])
    for y in (-4.2, -0.6, 3.0):
        builder.box((0, y, CEILING - 0.4), (6.0, 0.09, 0.1), paints.yellow)
    for x, y, half_x, half_y, material in (
        (0.0, 2.75, 2.6, 0.06, paints.yellow),
        (0.0, -2.8, 2.4, 0.06, paints.yellow),
        (2.75, 0.0, 0.08, 2.2, paints.cyan),
        (-2.8, 0.1, 0.06, 2.5, paints.yellow),
        (4.6, 1.0, 0.09, 3.2, paints.red),
    ):
        builder.box((x, y, 0.0), (half_x, half_y, 0.004), material, casts_shadow=False)


def _walls(builder: Builder, generator: np.random.Generator, paints: Paints) -> None:
    upper = (
        builder.material(corrugated(generator, palette("b4bcc0", "9aa6ac", "c8ccc8", "84a8b0"), 46), 6.6),
        builder.material(corrugated(generator, palette("5fa4b0", "7fb4bc", "a8b8bc", "4c8c9c"), 44), 6.6),
    )
    # No two racks or boards show the same part of a page: structure from motion would confuse those that look alike.
    pegboards = tuple(builder.material(pegboard(generator, 6, columns), 3.9) for columns in (13, 12))
    papers = (
        builder.material(materials.writing(generator, rgb("efe8d4"), rgb("2a2c34"), 40), 1.6),
        builder.material(materials.writing(generator, rgb("2a66ac"), rgb("eef4fa"), 32), 1.7),
        builder.material(materials.writing(generator, rgb("e8c84c"), rgb("8c1c1c"), 24), 1.5),
    )
    sky = materials.clouds(generator, rgb("6ca4d0"), rgb("c4dce8"), rgb("f4f8fa"))
    pane = builder.material(sky, 2.4, gloss=0.4, glow=0.8)
    goods = tuple(builder.material(packed_goods(generator, 12, 26), 4.8) for _ in range(2))
    racks = boards = 0
    for side in range(4):
        axes = turned(yaw=90 * side)
        middle = axes[0] * WALL
        builder.box(middle + axes[2] * 2.4, (0.25, 6.5, 2.4), upper[side % 2], axes=axes, casts_shadow=False)
        dado = (paints.yellow, paints.grey, paints.red, paints.cyan)[side]
        builder.box(middle + axes[2] * 0.3, (0.29, 6.5, 0.3), dado, axes=axes, casts_shadow=False)
        wall = Group(builder, middle - axes[0] * 0.27, axes)
        for number, offset in enumerate((-4.4, -2.5, -0.4, 1.7, 3.8)):
            kind = (number + 3 * side) % 5
            if kind < 2:
                _rack(wall, offset, goods[racks % 2], (racks // 2 % 2 / 2, racks // 4 / 2), paints)
                racks += 1
            elif kind == 2:
                _window(wall, offset, pane, paints)
            else:
                patch = (boards // 2 % 2 / 2, boards // 4 / 3)
                wall.box((0, offset, 1.55), (0.04, 0.95, 0.62), pegboards[boards % 2], patch=patch)
                boards += 1
                wall.box((0, offset, 2.22), (0.08, 1.0, 0.05), paints.wood)
            for _ in range(2):
                place = (-0.03, offset + generator.uniform(-0.3, 0.3) + 1.05, generator.uniform(0.85, 2.5))
                size = (0.02, generator.uniform(0.16, 0.26), generator.uniform(0.2, 0.32))
                wall.box(place, size, papers[int(generator.integers(3))], (0, 0, generator.uniform(-8, 8)))
        pipe = (paints.red, paints.yellow, paints.cyan, paints.steel)[side]
        wall.rod((-0.1, -6.2, 2.85), (-0.1, 6.2, 2.85), 0.07, pipe)


def _rack(wall: Group, offset: float, goods: Material, patch: Vector, paints: Paints) -> None:
    """A rack of shelves against the wall: packed goods at the back, with cans and boxes in front."""
    generator = wall.builder.generator
    wall.box((-0.1, offset, 1.0), (0.12, 0.8, 1.0), goods, patch=patch)
    for height in (0.12, 0.75, 1.4, 2.02):
        wall.box((-0.3, offset, height), (0.3, 0.85, 0.025), paints.steel)
    for height in (0.775, 1.425):
        for shift in (-0.4, 0.3):
            size = generator.uniform(0.12, 0.2)
            place = (-0.4, offset + shift + generator.uniform(-0.08, 0.08), height + size)
            material = (paints.label, paints.red, paints.cyan, paints.yellow, paints.wood)[int(generator.integers(5))]
            if generator.random() < 0.5:
                wall.box(place, (0.14, 0.8 * size, size), material, (generator.uniform(-12, 12), 0, 0))
            else:
                top = (place[0], place[1], height + 1.8 * size)
                wall.rod((place[0], place[1], height), top, 0.75 * size, material)


def _window(wall: Group, offset: float, pane: Material, paints: Paints) -> None:
    wall.box((0, offset, 1.7), (0.05, 0.8, 0.62), paints.cyan)
    for shift in (-0.38, 0.38):
        for height in (1.4, 1.98):
            wall.box((-0.03, offset + shift, height), (0.04, 0.33, 0.25), pane)
    wall.box((-0.15, offset, 1.03), (0.17, 0.85, 0.04), paints.wood)


def _tractor(group: Group, paints: Paints) -> None:
    """An old tractor that faces along the group's x axis."""
    group.box((0.0, 0, 0.42), (0.75, 0.13, 0.1), paints.grey)
    group.box((0.5, 0, 0.68), (0.42, 0.2, 0.19), paints.red)
    group.rod((0.1, 0, 0.84), (0.92, 0, 0.84), 0.19, paints.red)
    group.box((0.94, 0, 0.64), (0.03, 0.19, 0.24), paints.steel)
    group.box((-0.35, 0, 0.62), (0.28, 0.24, 0.14), paints.cyan)
    group.box((0.05, 0, 0.74), (0.06, 0.22, 0.24), paints.yellow)
    group.rod((0.35, 0.02, 0.95), (0.35, 0.02, 1.5), 0.035, paints.steel)
    group.rod((0.35, 0.02, 1.2), (0.35, 0.02, 1.42), 0.065, paints.grey)
    group.rod((0.0, 0, 0.9), (-0.2, 0, 1.12), 0.02, paints.steel)
    group.rod((-0.19, 0, 1.1), (-0.21, 0, 1.12), 0.17, paints.rubber)
    group.ball((-0.5, 0, 0.86), (0.2, 0.2, 0.07), paints.yellow)
    group.box((-0.68, 0, 0.98), (0.035, 0.19, 0.13), paints.yellow, (0, -12, 0))
    for side in (-1, 1):
        group.wheel((-0.5, 0.42 * side, 0.5), 0.5, 0.09, paints.rubber, paints.yellow)
        group.wheel((0.68, 0.36 * side, 0.26), 0.26, 0.055, paints.rubber, paints.yellow)
        group.box((-0.5, 0.4 * side, 1.04), (0.3, 0.14, 0.02), paints.red, (0, 6, 0))
        group.rod((0.9, 0.27 * side, 0.82), (1.0, 0.27 * side, 0.82), 0.06, paints.steel, end=0.085)
        for number in range(4):
            group.box((0.25 + 0.15 * number, 0.2 * side, 0.6), (0.05, 0.03, 0.07), paints.steel)
    group.rod((0.68, -0.36, 0.26), (0.68, 0.36, 0.26), 0.045, paints.grey)


def _bench(group: Group, paints: Paints) -> None:
    """A workbench with its length along the group's y axis."""
    group.box((0, 0, 0.7), (0.36, 0.85, 0.045), paints.wood)
    group.box((0, 0, 0.25), (0.3, 0.75, 0.025), paints.wood)
    for front in (-0.28, 0.28):
        for side in (-0.75, 0.75):
            group.box((front, side, 0.33), (0.05, 0.05, 0.33), paints.cyan)
    group.box((0.18, -0.55, 0.79), (0.12, 0.09, 0.05), paints.cyan)
    group.box((0.12, -0.55, 0.9), (0.05, 0.1, 0.07), paints.cyan)
    group.box((0.27, -0.55, 0.9), (0.04, 0.1, 0.07), paints.steel)
    group.rod((0.1, -0.55, 0.87), (0.46, -0.55, 0.87), 0.025, paints.steel)
    group.box((-0.1, 0.1, 0.84), (0.13, 0.24, 0.09), paints.red, (15, 0, 0))
    for place, radius, height in (((0.12, 0.5), 0.08, 0.2), ((-0.1, 0.62), 0.1, 0.16), ((-0.15, -0.3), 0.07, 0.24)):
        group.rod((*place, 0.745), (*place, 0.745 + height), radius, paints.label)
    group.box((0.0, -0.2, 0.39), (0.22, 0.3, 0.12), paints.label, (8, 0, 0))


def _motor(group: Group, paints: Paints) -> None:
    """A four-cylinder engine on a stand, with its gears on the front (the group's +x)."""
    for side in (-0.3, 0.3):
        group.box((0, side, 0.05), (0.4, 0.05, 0.05), paints.grey)
        group.rod((-0.25, side, 0.08), (0, 0.6 * side, 0.5), 0.035, paints.yellow)
        group.rod((0.25, side, 0.08), (0, 0.6 * side, 0.5), 0.035, paints.yellow)
    group.box((0, 0, 0.52), (0.4, 0.19, 0.07), paints.grey)
    group.box((0, 0, 0.69), (0.37, 0.15, 0.12), paints.cyan)
    for number in range(4):
        x = 0.19 * number - 0.285
        group.rod((x, 0, 0.8), (x, 0, 1.0), 0.085, paints.steel)
        group.rod((x, 0, 0.99), (x, 0, 1.05), 0.1, paints.red, end=0.06)
        group.rod((x, 0.08, 0.9), (x, 0.24, 0.84), 0.03, paints.rubber)
    group.rod((-0.4, 0.25, 0.82), (0.42, 0.25, 0.82), 0.05, paints.grey)
    for y, z, radius in ((0.0, 0.63, 0.17), (0.12, 0.86, 0.1), (-0.12, 0.84, 0.08)):
        group.rod((0.38, y, z), (0.44, y, z), radius, paints.steel)
        group.rod((0.38, y, z), (0.47, y, z), 0.45 * radius, paints.yellow)
        for number in range(6):
            angle = np.radians(60 * number + 20)
            tooth = (0.41, y + radius * float(np.cos(angle)), z + radius * float(np.sin(angle)))
            group.box(tooth, (0.028, 0.03, 0.02), paints.steel, (0, 0, 60 * number + 20))


def _cabinet(group: Group, paints: Paints) -> None:
    """A tool cabinet with its drawers on the front (the group's +x) and a globe lamp on top."""
    group.box((0, 0, 0.42), (0.24, 0.4, 0.4), paints.red)
    for number, material in enumerate((paints.yellow, paints.cyan, paints.grey, paints.yellow)):
        group.box((0.23, 0, 0.22 + 0.165 * number), (0.03, 0.36, 0.07), material)
        group.rod((0.28, -0.2, 0.24 + 0.165 * number), (0.28, 0.2, 0.24 + 0.165 * number), 0.014, paints.steel)
    group.rod((-0.08, 0.2, 0.82), (-0.08, 0.2, 1.25), 0.02, paints.steel)
    group.ball((-0.08, 0.2, 1.36), 0.14, paints.globe)
    group.box((0.0, -0.18, 0.88), (0.12, 0.16, 0.06), paints.label, (20, 0, 0))


def _stores(group: Group, paints: Paints) -> None:
    """Drums, tyres, crates, pipes and cans on the floor, and a standing lamp."""
    for x, y, radius, height, material in (
        (1.85, 0.75, 0.27, 0.82, paints.cyan),
        (1.5, 1.3, 0.27, 0.8, paints.yellow),
        (2.0, 0.25, 0.2, 0.55, paints.red),
        (-2.1, -0.4, 0.2, 0.6, paints.grey),
        (-2.15, 0.1, 0.13, 0.36, paints.label),
        (1.0, 2.0, 0.14, 0.4, paints.red),
    ):
        group.rod((x, y, 0), (x, y, height), radius, material)
        for part in (0.03, 0.5, 0.97):
            group.rod((x, y, height * part - 0.015), (x, y, height * part + 0.015), 1.06 * radius, material)
    for number, (x, y) in enumerate(((-1.8, -0.95), (-1.76, -0.99), (-1.83, -0.93))):
        lying = Group(group.builder, np.array([x, y, 0.12 + 0.23 * number]), turned(roll=90) @ turned(yaw=50 * number))
        rim = (paints.cyan, paints.red, paints.steel)[number]
        lying.wheel((0, 0, 0), 0.3 - 0.015 * number, 0.08, paints.rubber, rim)
    for x, y, z, half, yaw, material in (
        (1.95, -0.65, 0.2, 0.2, 25, paints.wood),
        (1.92, -0.62, 0.55, 0.15, 50, paints.label),
        (0.45, -2.2, 0.16, 0.16, 15, paints.wood),
        (-0.45, 2.05, 0.2, 0.2, 35, paints.label),
        (1.85, -1.2, 0.12, 0.12, 10, paints.red),
    ):
        group.box((x, y, z), (half, 1.2 * half, half), material, (yaw, 0, 0))
    for number, material in enumerate((paints.steel, paints.cyan, paints.steel, paints.red, paints.yellow)):
        y, z = 1.05 + 0.11 * (number % 3), 0.05 + 0.09 * (number // 3)
        group.rod((-0.75, y - 0.3, z), (0.75, y + 0.14, z), 0.05, material)
    group.rod((2.1, -0.2, 0.0), (2.1, -0.2, 0.04), 0.17, paints.grey)
    group.rod((2.1, -0.2, 0.04), (2.1, -0.2, 1.4), 0.022, paints.cyan)
    group.ball((2.1, -0.2, 1.53), 0.15, paints.globe)


def _ladder(group: Group, paints: Paints) -> None:
    """A stepladder that stands open along the group's x axis."""
    for side in (-0.22, 0.22):
        group.rod((0.42, 1.2 * side, 0), (0.03, side, 1.4), 0.028, paints.yellow)
        group.rod((-0.42, 1.2 * side, 0), (-0.03, side, 1.4), 0.028, paints.yellow)
    for number in range(5):
        part = 0.15 + 0.17 * number
        group.box((0.42 - 0.39 * part, 0, 1.4 * part), (0.06, 0.24, 0.016), paints.steel)
    group.box((0, 0, 1.41), (0.12, 0.26, 0.025), paints.red)
