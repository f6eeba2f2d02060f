from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.scene.undistortion import (
    LensView,
    Pinhole,
    corner_positions,
    cropping_lenses,
    folded_lenses,
    own_pinhole,
    refined,
    sees_whole_pinhole,
    shared_pinhole,
    shares_shown,
    training_size,
    undistort,
)


def radial(k: float, focal: float = 300.0, width: int = 400, height: int = 300) -> LensView:
    """A lens with one radial distortion parameter, like COLMAP's SIMPLE_RADIAL."""
    centre = np.array([width, height]) / 2

    def project(points: np.ndarray) -> np.ndarray:
        plane = points[:, :2] / points[:, 2:]
        return plane * (1 + k * (plane**2).sum(axis=1, keepdims=True)) * focal + centre

    def unproject(pixels: np.ndarray) -> np.ndarray:
        distorted = (pixels - centre) / focal
        plane = distorted.copy()
        for _ in range(100):
            plane = distorted / (1 + k * (plane**2).sum(axis=1, keepdims=True))
        return plane

    return LensView(project, unproject, width, height)


@given(st.tuples(st.integers(2, 5000), st.integers(2, 5000)), st.integers(16, 2000))
def test_training_sizes_are_even_and_keep_the_proportions(size: tuple[int, int], long_side: int) -> None:
    width, height = training_size(size, long_side)
    assert width % 2 == height % 2 == 0
    assert 2 <= max(width, height) <= min(long_side, max(size))
    scale = max(width, height) / max(size)
    assert abs(width - max(2, size[0] * scale)) <= 2
    assert abs(height - max(2, size[1] * scale)) <= 2


@given(st.floats(-0.15, 0.15))
def test_no_pixel_lies_outside_the_photo_and_none_is_given_away(k: float) -> None:
    lens = radial(k)
    pinhole = shared_pinhole([lens], 64, 48)
    assert sees_whole_pinhole(lens, pinhole)
    wider = Pinhole(pinhole.intrinsics * [[0.97, 1, 1], [1, 0.97, 1], [1, 1, 1]], 64, 48)
    assert not sees_whole_pinhole(lens, wider)
    assert pinhole.intrinsics[0, 0] == pinhole.intrinsics[1, 1]


def test_without_distortion_the_pinhole_is_the_photos_own() -> None:
    pinhole = shared_pinhole([radial(0.0)], 64, 48)
    np.testing.assert_allclose(pinhole.intrinsics, [[48, 0, 32], [0, 48, 24], [0, 0, 1]], atol=1e-9)


def plain(focal: tuple[float, float], middle: tuple[float, float], size: tuple[int, int], scale: float) -> LensView:
    """A lens without distortion, for photos of this size that were resized by `scale`."""
    factor = np.round(np.array(size) * scale) / size
    center, focals = np.array(middle) * factor, np.array(focal) * factor
    width, height = (int(side) for side in np.round(np.array(size) * scale))
    return LensView(
        lambda points: points[:, :2] / points[:, 2:] * focals + center,
        lambda pixels: (pixels - center) / focals,
        width,
        height,
    )


@pytest.mark.parametrize("scale", [1.0, 0.77, 0.1])
def test_photos_of_one_camera_without_distortion_keep_their_pixels(scale: float) -> None:
    """Except for an odd last row or column, whatever the focal lengths, the principal point and the matching size."""
    photo = np.random.default_rng(0).integers(0, 256, (83, 125, 3), dtype=np.uint8)
    lens = plain((110.0, 113.0), (61.3, 43.2), (125, 83), scale)
    pinhole = own_pinhole([lens, lens], (125, 83))
    assert pinhole is not None
    np.testing.assert_allclose(pinhole.intrinsics, [[110, 0, 61.3], [0, 113, 43.2], [0, 0, 1]])
    corners = corner_positions(lens, pinhole) * np.array([125 / lens.width, 83 / lens.height], np.float32)
    np.testing.assert_array_equal(undistort(photo, corners), photo[:82, :124])


def test_lenses_that_differ_or_distort_have_no_pixels_in_common() -> None:
    lens, other = radial(0.0), radial(0.0, focal=301.0)
    assert own_pinhole([lens], (400, 300)) is not None
    for lenses in ([lens, other], [radial(1e-4)], [lens, radial(-1e-4)], []):
        assert own_pinhole(lenses, (400, 300)) is None
    unseen = LensView(radial(0).project, lambda pixels: np.full((len(pixels), 2), np.nan), 400, 300)
    assert own_pinhole([unseen], (400, 300)) is None


def test_several_lenses_share_what_all_of_them_see() -> None:
    wide, narrow = radial(-0.1, focal=250.0), radial(0.05, focal=500.0)
    pinhole = shared_pinhole([wide, narrow], 64, 48)
    assert sees_whole_pinhole(wide, pinhole)
    assert sees_whole_pinhole(narrow, pinhole)
    np.testing.assert_allclose(pinhole.intrinsics, shared_pinhole([narrow], 64, 48).intrinsics)


def test_one_photo_upright_or_zoomed_crops_all_others() -> None:
    wide, upright, zoomed = radial(0.0), radial(0.0, width=300, height=400), radial(0.0, focal=900.0)
    assert shares_shown([wide, upright, wide], 64, 48) == pytest.approx((9 / 16, 1, 9 / 16))
    assert shares_shown([wide, zoomed], 64, 48) == pytest.approx((1 / 9, 1))
    barrel = radial(-0.15)
    assert shares_shown([barrel, barrel], 64, 48) == (1, 1)
    fields = [64 * 48 / shared_pinhole(lenses, 64, 48).intrinsics[0, 0] ** 2 for lenses in ([wide, upright], [wide])]
    assert shares_shown([wide, upright], 64, 48)[0] == pytest.approx(fields[0] / fields[1])


def test_few_photos_that_crop_all_others_are_told() -> None:
    """They were taken in the other orientation or zoomed; if many are, or if they crop little, they stay."""
    wide, upright, zoomed = radial(0.0), radial(0.0, width=300, height=400), radial(0.0, focal=900.0)
    lenses = [wide, upright, zoomed]
    assert cropping_lenses(lenses, [18, 1, 1], 64, 48) == [1, 2]
    assert cropping_lenses(lenses[:2], [9, 1], 64, 48) == [1]
    assert cropping_lenses(lenses[:2], [8, 2], 64, 48) == []
    assert cropping_lenses([wide, radial(0.0, focal=310.0)], [9, 1], 64, 48) == []
    assert cropping_lenses([], [], 64, 48) == []


def test_lenses_that_fold_over_are_refused() -> None:
    with pytest.raises(ValueError, match=r"fold over|no field of view"):
        shared_pinhole(
            [LensView(lambda points: np.full((len(points), 2), np.nan), radial(0).unproject, 400, 300)], 8, 6
        )


def test_lenses_that_are_none_are_told_from_the_others() -> None:
    unseen = LensView(radial(0).project, lambda pixels: np.full((len(pixels), 2), np.nan), 400, 300)
    nowhere = LensView(lambda points: np.full((len(points), 2), np.nan), radial(0).unproject, 400, 300)
    assert folded_lenses([radial(0.1), unseen, radial(-0.1), nowhere], 64, 48) == [1, 3]
    assert folded_lenses([radial(0.1), radial(-0.1, focal=500.0)], 64, 48) == []


@pytest.mark.parametrize("factor", [1, 3, 8, 20])
def test_an_undistorted_picture_is_the_mean_over_each_pixels_area(factor: int) -> None:
    photo = np.random.default_rng(0).integers(0, 256, (12 * factor, 16 * factor, 3), dtype=np.uint8)
    lens = radial(0.0, 20.0 * factor, 16 * factor, 12 * factor)
    pinhole = shared_pinhole([lens], 16, 12)
    expected = photo.reshape(12, factor, 16, factor, 3).mean(axis=(1, 3))
    difference = undistort(photo, corner_positions(lens, pinhole)) - expected
    assert np.abs(difference).max() <= 1.0


@pytest.mark.parametrize("k", [-0.12, 0.1])
def test_distortion_is_taken_out(k: float) -> None:
    """A photo through the lens, of a smooth pattern on the plane at depth 1, shows that pattern undistorted."""

    def pattern(plane: np.ndarray) -> np.ndarray:
        waves = np.stack([np.sin(9 * plane[..., 0]), np.cos(11 * plane[..., 1]), np.sin(7 * plane.sum(axis=-1))])
        return np.round(127.5 + 120 * np.moveaxis(waves, 0, -1))

    def centres(width: int, height: int) -> np.ndarray:
        return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)

    lens = radial(k)
    photo = pattern(lens.unproject(centres(400, 300).reshape(-1, 2)).reshape(300, 400, 2)).astype(np.uint8)
    pinhole = shared_pinhole([lens], 100, 74)
    plane = (centres(100, 74) - pinhole.intrinsics[:2, 2]) / pinhole.intrinsics[0, 0]
    shown = undistort(photo, corner_positions(lens, pinhole)).astype(float)
    assert np.abs(shown - pattern(plane)).max() < 3.0


def test_refined_positions_are_linear_between_corners() -> None:
    corners = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).astype(np.float32)
    expected = np.stack(np.meshgrid(np.arange(8) / 2 + 0.25, np.arange(6) / 2 + 0.25), axis=-1)
    np.testing.assert_allclose(refined(corners, 2), expected)


def test_huge_photos_do_not_alias() -> None:
    stripes = np.zeros((480, 640, 3), np.uint8)
    stripes[:, ::2] = 255
    lens = radial(0.0, 640.0, 640, 480)
    shown = undistort(stripes, corner_positions(lens, shared_pinhole([lens], 16, 12)))
    assert np.abs(shown.astype(int) - 128).max() <= 8
    assert cv2.mean(shown)[0] == pytest.approx(127.5, abs=1)
