"""Pictures show things where their cameras project them, in the right colour, with the same bits for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing import photograph
from stages.tracing.photograph import Studio
from stages.tracing.rig import look_at
from stages.tracing.world import Builder, Sky, turned
from tests.stages.tracing.worlds import builder, plain

WIDTH, HEIGHT = 96, 72
INTRINSICS = np.array([[90.0, 0, 44], [0, 85.0, 40], [0, 0, 1]])
POSE = look_at(np.array([3.5, -1.5, 1.8]), np.array([0.1, 0.0, 0.5]), tilt=0.1)
BALLS = np.array([[0.0, 0.0, 0.5], [-1.2, 0.8, 0.3], [0.9, 0.7, 0.9], [-0.4, -1.1, 1.2]])
RADIUS = 0.2


def balls() -> Builder:
    build = builder()
    build.ball((0, 0, 0), 12.0, plain(build, (0.2, 0.3, 0.8), glow=1.0), casts_shadow=False)
    red = plain(build, (0.9, 0.1, 0.1))
    for place in BALLS:
        build.ball(place, RADIUS, red)
    return build


def studio(build: Builder, **settings: float) -> Studio:
    return Studio(build.world(Sky((0.6, 0.6, 0.6), (0.3, 0.3, 0.3))), **settings)


def picture(taken_in: Studio, samples: int = 4, seed: int = 0) -> np.ndarray:
    return taken_in.photograph(POSE, INTRINSICS, WIDTH, HEIGHT, samples, np.random.default_rng(seed))


def projected(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel places [2, N] and depths [N] of world points [N, 3]."""
    inside = POSE[:3, :3] @ points.T + POSE[:3, 3:]
    pixel = INTRINSICS @ inside
    return pixel[:2] / pixel[2], inside[2]


def test_a_point_on_a_surface_has_its_depth_at_its_pixel() -> None:
    camera = -POSE[:3, :3].T @ POSE[:3, 3]
    towards = camera - BALLS
    facing = BALLS + RADIUS * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    place, depth = projected(facing)
    assert ((place > 0) & (place < [[WIDTH], [HEIGHT]])).all()
    found = studio(balls()).depth(POSE, INTRINSICS, place.astype(np.float32))
    np.testing.assert_allclose(found, depth, rtol=1e-4)


def test_things_appear_where_they_project() -> None:
    shown = picture(studio(balls())).astype(int)
    red = shown[..., 0] > shown[..., 2]
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    expected = np.zeros((HEIGHT, WIDTH), bool)
    for place, depth in zip(*(part.T for part in projected(BALLS)), strict=True):
        expected |= ((x - place[0]) / 90) ** 2 + ((y - place[1]) / 85) ** 2 < (RADIUS / depth) ** 2
    assert expected.sum() > 200
    # Only pixels on the balls' outlines may differ: perspective makes circles slightly oval.
    assert (red != expected).mean() < 0.01
    assert (red & expected).sum() > 0.9 * expected.sum()


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    first = studio(balls())
    assert np.array_equal(picture(first), picture(studio(balls())))
    assert not np.array_equal(picture(first), picture(first, seed=1))


def test_a_picture_does_not_depend_on_how_rays_are_grouped(monkeypatch: pytest.MonkeyPatch) -> None:
    taken_in = studio(balls())
    whole = picture(taken_in).astype(int)
    monkeypatch.setattr(photograph, "TILE_RAYS", 144)
    tiled = picture(taken_in)
    # Other tiles sample other places within the pixels; nothing else changes.
    assert not np.array_equal(tiled, whole)
    assert np.median(np.abs(tiled - whole)) < 2
    assert np.abs(tiled - whole).mean() < 2


def test_more_samples_only_smooth() -> None:
    taken_in = studio(balls())
    one, many = (picture(taken_in, samples).astype(int) for samples in (1, 16))
    assert np.abs(one - many).mean() < 3
    tones = [len(np.unique(shown.reshape(-1, 3), axis=0)) for shown in (one, many)]
    assert tones[1] > tones[0]


def test_a_number_of_samples_that_is_no_square_is_refused() -> None:
    with pytest.raises(ValueError, match="square number: 5"):
        picture(studio(balls()), samples=5)


def test_a_glowing_surface_shows_its_own_colour() -> None:
    build = builder()
    build.ball((0, 0, 0), 12.0, plain(build, (0.5, 0.5, 0.5), glow=1.0))
    shown = picture(studio(build))
    assert len(np.unique(shown)) == 1
    light = 0.5**2.2
    assert abs(int(shown[0, 0, 0]) - 255 * (1 - np.exp(-1.6 * light)) ** (1 / 2.2)) < 2


def test_gloss_mirrors_what_stands_beside() -> None:
    def shown(gloss: float) -> np.ndarray:
        build = builder()
        build.ball((0, 0, 0), 12.0, plain(build, (0.1, 0.1, 0.1)), casts_shadow=False)
        build.box((0, 0, -0.5), (9, 9, 0.5), plain(build, (0.3, 0.3, 0.3), gloss=1.0))
        build.box((-1.5, 0, 1.0), (0.1, 1.5, 1.0), plain(build, (1.0, 0.0, 0.0), glow=1.0))
        return picture(studio(build, gloss=gloss)).astype(int)

    matt, shiny = shown(0.0), shown(1.0)
    place, _ = projected(np.array([[-0.7, 0.0, 0.0]]))
    column, row = place[:, 0].astype(int)
    redness = [image[row, column, 0] - image[row, column, 1] for image in (matt, shiny)]
    assert redness[0] <= 1
    assert redness[1] > redness[0] + 5


def test_where_nothing_is_met_it_is_dark() -> None:
    build = builder()
    build.ball((0.1, 0.0, 0.5), 0.3, plain(build, (0.9, 0.9, 0.9)))
    shown = picture(studio(build))
    assert shown[0, 0].tolist() == [0, 0, 0]
    assert shown[HEIGHT // 2, WIDTH // 2].min() > 50


def test_a_tint_multiplies_the_paint() -> None:
    build = builder()
    build.ball((0, 0, 0), 12.0, plain(build, (0.5, 0.5, 0.5), glow=1.0), tint=(1, 0.5, 0))
    red, green, blue = picture(studio(build))[0, 0]
    assert red > green > blue == 0


def test_an_edge_between_two_faces_of_a_box_is_smooth() -> None:
    build = builder()
    build.box((0, 0, 0.5), (1.2, 1.2, 0.7), plain(build, (0.8, 0.8, 0.8)), axes=turned(yaw=20))
    build.sun((0.3, -0.2, 1.0), (1, 1, 1))
    taken_in = studio(build)
    fine = taken_in.photograph(
        POSE, INTRINSICS * [[4], [4], [1]], 4 * WIDTH, 4 * HEIGHT, 1, np.random.default_rng(0)
    ).reshape(HEIGHT, 4, WIDTH, 4, 3)
    inside = (fine > 0).all(axis=(1, 3))
    contrast = np.ptp(fine.astype(int), axis=(1, 3))
    edge = inside & (contrast > 15)
    assert edge[..., 0].sum() > 40
    apart = np.abs(picture(taken_in, samples=16) - fine.mean(axis=(1, 3)))
    assert (apart[edge] / contrast[edge]).mean() < 0.18
