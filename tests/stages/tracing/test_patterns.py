"""Patterns tile without a seam, stay in [0, 1], and are what their names say."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.patterns import courses, fractal, marks, noise, soften, stones

SIZE = 128


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def seam(field: np.ndarray) -> float:
    """The largest jump of a field across the page's border, relative to the largest within the page."""
    across, within = np.abs(field[0] - field[-1]).max(), np.abs(np.diff(field, axis=0)).max()
    down, beside = np.abs(field[:, 0] - field[:, -1]).max(), np.abs(np.diff(field, axis=1)).max()
    return float(max(across / within, down / beside))


@pytest.mark.parametrize(
    "field",
    [
        noise(SIZE, 6, generator()),
        noise(SIZE, 6, generator(), 13),
        fractal(SIZE, 3, generator(), octaves=4),
        courses(SIZE, 8, 4, generator()).inset,
        stones(SIZE, 7, generator()).inset,
    ],
    ids=["noise", "stretched noise", "fractal", "courses", "stones"],
)
def test_pages_have_no_seam_and_stay_in_range(field: np.ndarray) -> None:
    assert field.shape == (SIZE, SIZE)
    assert field.dtype == np.float32
    assert seam(field) <= 1.01
    assert field.min() >= 0
    assert field.max() <= 1


def test_noise_takes_the_lattice_s_values() -> None:
    lattice = generator(4).random((8, 8), dtype=np.float32)
    assert np.allclose(noise(SIZE, 8, generator(4))[:: SIZE // 8, :: SIZE // 8], lattice, atol=1e-6)


def test_stones_are_voronoi_cells_on_a_torus() -> None:
    count = 5
    bed = stones(SIZE, count, generator(9))
    jitter = generator(9).random((count, count, 2), dtype=np.float32)
    seeds = (np.stack(np.meshgrid(np.arange(count), np.arange(count), indexing="ij"), -1) + jitter).reshape(
        -1, 2
    ) / count
    place = (np.arange(SIZE) + 0.5) / SIZE
    texels = np.stack(np.meshgrid(place, place, indexing="ij"), -1)[:, :, None]
    apart = np.abs(texels - seeds)
    distance = np.sort(np.linalg.norm(np.minimum(apart, 1 - apart), axis=-1), axis=-1)
    nearest = np.linalg.norm(np.minimum(apart, 1 - apart), axis=-1).argmin(axis=-1)
    assert (bed.index == nearest).mean() > 0.999
    assert np.allclose(bed.inset, (distance[..., 1] - distance[..., 0]) / 2, atol=1e-5)


def test_courses_have_their_rows_and_columns_and_tones_differ() -> None:
    wall = courses(SIZE, 8, 4, generator())
    assert len(np.unique(wall.index)) == wall.count == 32
    tone = wall.tone(generator())
    assert len(np.unique(tone)) == 32
    for number in range(wall.count):
        assert len(np.unique(tone[wall.index == number])) == 1


def test_softening_keeps_the_coarse_and_fades_the_fine() -> None:
    page = np.random.default_rng(0).random((SIZE, SIZE, 3), dtype=np.float32) * np.float32(0.4) + np.float32(0.3)
    page[: SIZE // 2] += np.float32(0.2)
    soft = soften(page, 8, 0.5)
    assert np.allclose(soft.mean(axis=(0, 1)), page.mean(axis=(0, 1)), atol=1e-4)
    inner = slice(16, SIZE // 2 - 16)
    assert soft[inner].std() == pytest.approx(0.5 * page[inner].std(), rel=0.05)
    assert soft[inner].mean() - soft[SIZE // 2 + 16 : -16].mean() == pytest.approx(0.2, abs=0.01)
    assert np.allclose(soften(page, 8, 1.0), page, atol=1e-6)
    rolled = soften(np.roll(page, (8, 16), axis=(0, 1)), 8, 0.5)
    assert np.allclose(rolled, np.roll(soft, (8, 16), axis=(0, 1)), atol=1e-6)


def test_marks_are_ink_on_paper() -> None:
    page = marks(SIZE, 10, generator())
    assert set(np.unique(page)) == {0, 1}
    assert 0.1 < page.mean() < 0.5
