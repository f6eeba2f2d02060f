"""The points of a COLMAP model are read exactly as stored, and files that no model has are refused."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.scene import colmap_points
from stages.scene.colmap_points import ModelPoints, points_seen_by, read_colmap_points
from tests.stages.scene.test_colmap import write_binary_model, write_text_model

POINTS = [
    (7, (0.5, -2.0, 1e3), (255, 0, 3), 0.25, [(2, 0), (1, 5)]),
    (3, (1e-7, 1 / 3, 0.0), (1, 2, 250), 1.5, [(1, 1), (1, 2), (9, 4)]),
    (2**40, (0.0, 0.0, 0.0), (0, 0, 0), -1.0, []),
    (1, (1.0, 2.0, 3.0), (9, 8, 7), 0.75, [(2, 3)]),
]
"""Number, position, colour, error, and the photo and observation of each view."""


def binary_point(number: int, position: tuple, color: tuple, error: float, views: list) -> bytes:
    fixed = struct.pack("<Q3d3BdQ", number, *position, *color, error, len(views))
    return fixed + b"".join(struct.pack("<II", *view) for view in views)


def write_binary_points(folder: Path, points: list = POINTS) -> Path:
    write_binary_model(folder)
    path = folder / "points3D.bin"
    path.write_bytes(struct.pack("<Q", len(points)) + b"".join(binary_point(*point) for point in points))
    return path


def write_text_points(folder: Path, points: list = POINTS) -> Path:
    write_text_model(folder)
    lines = [
        " ".join(map(repr, (number, *position, *color, error, *(value for view in views for value in view))))
        for number, position, color, error, views in points
    ]
    path = folder / "points3D.txt"
    path.write_text("\n".join(["\ufeff# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]", "", *lines]) + "\n")
    return path


def read(folder: Path) -> ModelPoints:
    points = read_colmap_points(folder)
    assert points is not None
    return points


@pytest.mark.parametrize("write", [write_binary_points, write_text_points])
def test_both_forms_are_read_to_the_last_bit_and_in_order(tmp_path: Path, write) -> None:
    write(tmp_path)
    points = read(tmp_path)
    np.testing.assert_array_equal(points.positions, [position for _, position, *_ in POINTS])
    np.testing.assert_array_equal(points.colors, [color for _, _, color, *_ in POINTS])
    assert (points.positions.dtype, points.colors.dtype) == (np.float64, np.uint8)
    assert points.errors.tolist() == [0.25, 1.5, -1, 0.75]
    assert points.views.tolist() == [2, 3, 0, 1]
    assert points.photos.tolist() == [2, 1, 1, 1, 9, 2]


def unseen(photos: int) -> Callable[[np.ndarray], np.ndarray]:
    """A projection by which no photo sees any point."""
    return lambda positions: np.zeros(photos, np.int64)


@pytest.mark.parametrize("write", [write_binary_points, write_text_points])
def test_no_points_are_none(tmp_path: Path, write) -> None:
    path = write(tmp_path, [])
    assert len(read(tmp_path).positions) == 0
    assert points_seen_by(read(tmp_path), [1, 2], unseen(2)) is None
    path.unlink()
    assert read_colmap_points(tmp_path) is None


def test_points_in_another_form_than_the_model_are_not_its_own(tmp_path: Path) -> None:
    write_text_points(tmp_path)
    write_binary_model(tmp_path)
    assert read_colmap_points(tmp_path) is None


def test_only_what_the_photos_see_counts(tmp_path: Path) -> None:
    """Photo 1 sees the second point twice, and photo 9 is not among the first two given."""
    write_binary_points(tmp_path, [point for point in POINTS if point[-1]])
    both = points_seen_by(read(tmp_path), [2, 1], unseen(2))
    assert both is not None
    np.testing.assert_array_equal(both.positions, [POINTS[row][1] for row in (0, 1, 3)])
    np.testing.assert_array_equal(both.colors, [POINTS[row][2] for row in (0, 1, 3)])
    assert both.seen.tolist() == [2, 2]
    assert both.error == pytest.approx((2 * 0.25 + 2 * 1.5 + 0.75) / 5)
    last = points_seen_by(read(tmp_path), [9], unseen(1))
    assert last is not None
    assert (last.positions.tolist(), last.seen.tolist(), last.error) == ([[1e-7, 1 / 3, 0.0]], [1], 1.5)
    assert points_seen_by(read(tmp_path), [4, 10], unseen(2)) is None


def test_points_of_which_no_view_is_listed_count_by_projection(tmp_path: Path) -> None:
    """Programs that match no photos, such as those that start from laser scans, list none."""
    write_binary_points(tmp_path)
    (third,) = (point[1] for point in POINTS if not point[-1])
    projected: list[list[float]] = []

    def project(positions: np.ndarray) -> np.ndarray:
        projected.extend(positions.tolist())
        return np.array([0, 1])

    found = points_seen_by(read(tmp_path), [4, 2], project)
    assert found is not None
    assert projected == [list(third)]
    assert list(third) in found.positions.tolist()
    assert found.seen.tolist() == [0, 1 + sum(any(view[0] == 2 for view in point[-1]) for point in POINTS)]
    alone = points_seen_by(read(tmp_path), [4, 10], project)
    assert alone is not None
    assert (alone.positions.tolist(), alone.error) == ([list(third)], None)


@pytest.mark.parametrize("error", [-1.0, np.nan, np.inf, 1.7e308])
def test_an_error_that_nobody_measured_is_unknown(tmp_path: Path, error: float) -> None:
    write_binary_points(tmp_path, [(1, (0.0, 0.0, 0.0), (0, 0, 0), error, [(1, 0)])])
    points = points_seen_by(read(tmp_path), [1], unseen(1))
    assert points is not None
    assert points.error is None


def expect_refusal(path: Path, *words: str) -> None:
    with pytest.raises(UserError) as raised:
        read_colmap_points(path.parent)
    said = str(raised.value)
    assert all(word in said for word in (path.name, "take this file out", *words)), said


@pytest.mark.parametrize("kept", [0, 4, 8, 30, 58, 60, -1])
def test_a_shortened_file_is_refused(tmp_path: Path, kept: int) -> None:
    path = write_binary_points(tmp_path)
    path.write_bytes(path.read_bytes()[:kept])
    expect_refusal(path)


@pytest.mark.parametrize(("count", "words"), [(5, "too early"), (3, "bytes follow its 3 points"), (2**63, "points in")])
def test_another_number_of_points_than_there_are_is_refused(tmp_path: Path, count: int, words: str) -> None:
    path = write_binary_points(tmp_path, [(9, (0.0, 0.0, 0.0), (0, 0, 0), 0.0, [(1, 0)] * 20), *POINTS[1:]])
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    expect_refusal(path, words)


def test_views_that_no_file_could_hold_take_no_room(tmp_path: Path) -> None:
    path = write_binary_points(tmp_path)
    for views in (2**31, 2**61, 2**64 - 1):
        path.write_bytes(struct.pack("<Q", 1) + binary_point(*POINTS[2])[:-8] + struct.pack("<Q", views))
        tracemalloc.start()
        try:
            expect_refusal(path, "too early")
            assert tracemalloc.get_traced_memory()[1] < 1_000_000
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize("far", [np.nan, np.inf, -1e10])
@pytest.mark.parametrize("write", [write_binary_points, write_text_points])
def test_points_where_no_scene_has_any_are_refused(tmp_path: Path, write, far: float) -> None:
    path = write(tmp_path, [POINTS[0], (5, (0.0, far, 0.0), (0, 0, 0), 0.0, [(1, 0)])])
    expect_refusal(path, f"point 2 of 2 lies at 0, {far:g}, 0")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 0 0 0 1 2 3", "7 numbers"),
        ("1 0 0 0 1 2 3 0.5 1", "9 numbers"),
        ("1 0 zero 0 1 2 3 0.5", "zero"),
        ("1 0 0 0 256 2 3 0.5", "greater than maximum"),
        ("1 0 0 0 -1 2 3 0.5", "less than minimum"),
        (f"1 0 0 0 1 2 3 0.5 {10**30} 0", "int"),
        (f"1 0 0 0 1 2 3 0.5 {'1 0 ' * 1000}", "longer than 1000 bytes"),
    ],
)
def test_a_line_that_is_no_point_is_named(
    tmp_path: Path, line: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(colmap_points, "LONGEST_LINE", 1000)
    path = write_text_points(tmp_path)
    path.write_text(f"# points\n\n{line}\n")
    expect_refusal(path, "line 3", words)


def test_a_file_of_absurd_size_is_not_read(tmp_path: Path) -> None:
    path = write_binary_points(tmp_path)
    with path.open("r+b") as file:
        file.truncate(2**40)  # sparse
    expect_refusal(path, "1099511627776 bytes")
