"""Distortions do what their severities say."""

from __future__ import annotations

import numpy as np
import pytest

from stages.imaging.distortions import (
    DISTORTIONS,
    WORDING,
    blurred,
    brightened,
    cropped,
    jpeg,
    noisy,
    random_distortion,
    random_recoloring,
    random_tint,
    resized,
    smaller,
)


def generator() -> np.random.Generator:
    return np.random.default_rng(0)


def noise_picture() -> np.ndarray:
    return generator().integers(0, 256, (64, 48, 3)).astype(np.uint8)


def test_noise_has_the_sigma_that_it_states() -> None:
    grey = np.full((200, 200, 3), 128, np.uint8)
    for sigma in (2.0, 5.0):
        error = noisy(sigma).apply(grey, generator()).astype(float) - 128
        assert error.std() == pytest.approx(np.hypot(sigma, np.sqrt(1 / 12)), rel=0.01)


def test_blur_has_the_sigma_that_it_states() -> None:
    step = np.zeros((41, 401, 3), np.uint8)
    step[:, 200:] = 255
    slope = np.diff(blurred(4.0).apply(step, generator())[20, :, 0].astype(float))
    places = np.arange(len(slope))
    middle = (slope * places).sum() / slope.sum()
    assert np.sqrt((slope * (places - middle) ** 2).sum() / slope.sum()) == pytest.approx(4.0, rel=0.05)


def test_blur_is_the_same_along_both_axes_and_mixes_no_colours() -> None:
    picture = noise_picture()
    picture[..., 1] = 128
    shown = blurred(1.0).apply(picture, generator())
    assert (shown[..., 1] == 128).all()
    np.testing.assert_array_equal(blurred(1.0).apply(picture.transpose(1, 0, 2), generator()).transpose(1, 0, 2), shown)


def test_stronger_compression_and_smaller_sizes_lose_more() -> None:
    picture = noise_picture()

    def error(distortion: object) -> float:
        return float(np.square(distortion.apply(picture, generator()).astype(float) - picture).mean())  # type: ignore

    for full_color in (False, True):
        assert 0 < error(jpeg(90, full_color)) < error(jpeg(70, full_color)) < error(jpeg(50, full_color))
    assert 0 < error(resized(0.8)) < error(resized(0.5))


def test_what_is_reduced_and_enlarged_again_is_no_smaller() -> None:
    """`resized` keeps the size, as its wording says; `smaller` halves the sides and makes them even."""
    picture = np.zeros((66, 48, 3), np.uint8)
    assert resized(0.5).apply(picture, generator()).shape == (66, 48, 3)
    assert smaller(0.5).apply(picture, generator()).shape == (32, 24, 3)
    assert "enlarged again" in WORDING["resize"]
    assert {resized(0.5).name, smaller(0.5).name} <= {each.name for each in DISTORTIONS}


def test_most_programs_halve_the_resolution_of_colors() -> None:
    stripes = np.zeros((32, 32, 3), np.uint8)
    stripes[:, ::2] = (255, 0, 0)
    stripes[:, 1::2] = (0, 130, 0)  # of the same luma
    kept = {full: jpeg(95, full).apply(stripes, generator()).astype(int) for full in (True, False)}
    difference = {full: np.abs(np.diff(picture[..., 0], axis=1)).mean() for full, picture in kept.items()}
    assert difference[True] > 200
    assert difference[False] < 20


def test_a_crop_is_a_part_and_brightness_a_factor() -> None:
    picture = noise_picture()
    part = cropped(0.75).apply(picture, generator())
    assert part.shape == (48, 36, 3)
    rows = [
        row
        for row in range(17)
        for column in range(13)
        if (picture[row : row + 48, column : column + 36] == part).all()
    ]
    assert len(rows) == 1
    for level, factor, expected in ((100, 0.5, 50), (103, 0.5, 52), (100, 3.0, 255)):
        shown = brightened(factor).apply(np.full((2, 2, 3), level, np.uint8), generator())
        np.testing.assert_array_equal(shown, expected)


def test_a_crop_is_at_any_place() -> None:
    rows, columns = np.mgrid[:8, :8].astype(np.uint8)
    picture, draws = np.stack([rows, columns, rows], axis=-1), generator()
    corners = {tuple(cropped(0.75).apply(picture, draws)[0, 0, :2].tolist()) for _ in range(200)}
    assert corners == {(row, column) for row in range(3) for column in range(3)}


def test_one_in_seven_random_distortions_is_none() -> None:
    draws, picture = generator(), noise_picture()
    made = [random_distortion(picture, draws) for _ in range(700)]
    assert sum(np.array_equal(each, picture) for each in made) == pytest.approx(100, abs=30)
    assert sum(each.shape != picture.shape for each in made) == pytest.approx(100, abs=40), "cropped"
    again = generator()
    assert all(np.array_equal(random_distortion(picture, again), each) for each in made[:20])


@pytest.mark.parametrize("distortion", DISTORTIONS, ids=lambda each: f"{each.name} {each.severity}")
def test_all_are_named_and_leave_even_sides(distortion) -> None:
    picture = distortion.apply(noise_picture(), generator())
    assert distortion.name in WORDING
    assert picture.dtype == np.uint8
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0


def test_a_random_recoloring_leaves_every_other_picture_and_keeps_its_lines() -> None:
    rows = np.linspace(60, 200, 12).astype(np.uint8)
    picture = np.stack(np.broadcast_arrays(rows[:, None], rows[None, :], np.uint8(120)), axis=-1)
    made = [random_recoloring(picture, np.random.default_rng(seed)) for seed in range(200)]
    changed = [each for each in made if not np.array_equal(each, picture)]
    assert 70 < len(changed) < 130
    assert all(each.dtype == np.uint8 and each.shape == picture.shape for each in changed)
    spans = [int(each.max()) - int(each.min()) for each in changed]
    assert min(spans) < 60 < 140 < max(spans), "from nearly flat to stronger than it was"
    for each in changed:
        assert (np.diff(each[..., 0].astype(int), axis=0) >= 0).all(), "what was brighter stays so"
    assert np.array_equal(random_recoloring(picture, np.random.default_rng(7)), made[7])


def test_a_random_recoloring_moves_the_mean_up_as_often_as_down() -> None:
    grey = np.full((2, 2, 3), 128, np.uint8)
    moved = [random_recoloring(grey, np.random.default_rng(seed)).astype(int) - 128 for seed in range(400)]
    moved = [each for each in moved if each.any()]
    assert abs(np.mean(moved)) < 15
    assert np.min(moved) < -90
    assert np.max(moved) > 90


def test_a_random_tint_is_a_slight_one() -> None:
    draws = generator()
    gains, shifts = (np.array(each) for each in zip(*(random_tint(draws) for _ in range(300)), strict=True))
    assert gains.dtype == shifts.dtype == np.float32
    assert (gains.min(), gains.max()) == pytest.approx((0.8, 1.2), abs=0.01)
    assert (shifts.min(), shifts.max()) == pytest.approx((-0.1, 0.1), abs=0.005)
