"""Culling loses no hit: the tracer agrees with trying every solid on every ray."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.shapes import Coordinates
from stages.tracing.tracer import Bundles, Tracer
from stages.tracing.world import Solid, turned
from tests.stages.tracing.worlds import builder, plain


def clutter() -> tuple[Solid, ...]:
    """Sixty solids of all kinds in a room."""
    build = builder()
    stuff, generator = plain(build), np.random.default_rng(11)
    build.box((0, 0, 1.5), (5, 5, 2.5), stuff)
    for number in range(60):
        place = generator.uniform(-2.5, 2.5, 3)
        half = generator.uniform(0.02, 0.5, 3)
        if number % 3 == 0:
            build.box(place, half, stuff, axes=turned(*generator.uniform(0, 360, 3)))
        elif number % 3 == 1:
            build.ball(place, half, stuff, axes=turned(*generator.uniform(0, 360, 3)))
        else:
            build.rod(place, place + generator.normal(size=3), half[0], stuff, end_radius=half[1])
    return tuple(build.solids)


def every_solid_on_every_ray(
    solids: tuple[Solid, ...], origin: Coordinates, direction: Coordinates
) -> tuple[np.ndarray, np.ndarray]:
    distances = np.stack(
        [
            solid.shape.hit(solid.frame.point_to_local(origin), solid.frame.direction_to_local(direction))
            for solid in solids
        ]
    )
    return distances.min(axis=0), distances.argmin(axis=0)


def rays(kind: str, count: int = 1500) -> tuple[Coordinates, Coordinates]:
    generator = np.random.default_rng(5)
    direction = generator.normal(size=(3, count))
    if kind == "a narrow view":
        direction = np.array([[-1.0], [0.1], [-0.1]]) + 0.3 * direction.clip(-1, 1)
    direction /= np.linalg.norm(direction, axis=0)
    origin = (
        np.array([[3.5], [0.0], [1.0]])
        if kind == "a narrow view"
        else generator.uniform(-3, 3, (3, count)) * [[1], [1], [0.3]]
    )
    x, y, z = origin.astype(np.float32)
    a, b, c = direction.astype(np.float32)
    return (x, y, z), (a, b, c)


@pytest.mark.parametrize("kind", ["a narrow view", "from everywhere to everywhere"])
def test_culling_loses_nothing(kind: str) -> None:
    solids = clutter()
    origin, direction = rays(kind)
    distance, winner = Tracer(solids).first(origin, direction)
    expected, nearest = every_solid_on_every_ray(solids, origin, direction)
    assert len(np.unique(winner)) > 20
    # The same arithmetic on the same rays; shared origins are not repeated, so the last bit may differ.
    np.testing.assert_allclose(distance, expected, rtol=1e-5)
    assert (winner == nearest).mean() > 0.999


def test_a_ray_that_meets_nothing_says_so() -> None:
    build = builder()
    build.ball((0, 0, 0), 0.5, plain(build))
    one = np.ones(1, np.float32)
    distance, winner = Tracer(build.solids).first((2 * one, 0 * one, 0 * one), (one, 0 * one, 0 * one))
    assert np.isinf(distance).all()
    assert (winner == -1).all()


def test_a_world_without_solids_is_empty() -> None:
    one = np.ones(1, np.float32)
    distance, winner = Tracer(()).first((one, one, one), (one, 0 * one, 0 * one))
    assert np.isinf(distance).all()
    assert (winner == -1).all()


def test_bundles_hold_all_their_rays() -> None:
    generator = np.random.default_rng(2)
    origin = generator.normal(scale=0.2, size=(3, 5, 64)).astype(np.float32)
    axes = generator.normal(size=(3, 5, 1))
    direction = (generator.normal(scale=0.2, size=(3, 5, 64)) + axes / np.linalg.norm(axes, axis=0)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=0)
    bundles = Bundles.around(origin, direction)
    places = (origin + generator.uniform(0, 4, (1, 5, 64)).astype(np.float32) * direction).reshape(3, -1).T
    reached = bundles.reach(places.astype(np.float64), np.full(len(places), 1e-4))
    own = np.repeat(np.arange(5), 64)
    assert reached[own, np.arange(len(places))].all()
    assert reached.mean() < 0.6
