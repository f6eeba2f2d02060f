"""Reading the points of a COLMAP model, binary or text: positions, colours, and which photos see each.

A model may have a million points, each with a list of the photos that see it, so values are read straight into arrays.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.errors import UserError
from stages.scene.colmap import LARGEST_TRANSLATION, suffix_of_model
from stages.scene.known_points import KnownPoints

PART = "points3D"
LARGEST_FILE = 2**31
"""Bytes, enough for about ten million points; reading takes as much memory."""
LONGEST_LINE = 2**20
"""Bytes of text; each photo that sees a point adds about fifteen to its line."""
LARGEST_ERROR = 1e6
"""Pixels; a larger reprojection error counts as not measured."""
COUNT = struct.Struct("<Q")
POINT = np.dtype([("id", "<u8"), ("position", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("views", "<u8")])
"""The part of a point's binary record before its views."""
VIEW = np.dtype([("photo", "<u4"), ("observation", "<u4")])
NUMBERS_OF_A_POINT = 8  # in a line of text: id, position, colour, error; then two for each view


@dataclass(frozen=True)
class ModelPoints:
    """P points, in the file's order.

    `errors`: mean reprojection error of each point in pixels; negative or not finite if the model does not state it.
    `views`: the number of views of each point. `photos`: the image ids of all E views, point after point.
    """

    positions: Float64[np.ndarray, "P 3"]
    colors: UInt8[np.ndarray, "P 3"]
    errors: Float64[np.ndarray, " P"]
    views: Int64[np.ndarray, " P"]
    photos: Int64[np.ndarray, " E"]


def read_colmap_points(folder: Path) -> ModelPoints | None:
    """The points of the model directly in this folder, in the same format as its cameras and images.

    None if the model is incomplete or has no file of points. Raises `UserError` for a file that is damaged or larger
    than `LARGEST_FILE`, or has points beyond `LARGEST_TRANSLATION`.
    """
    suffix = suffix_of_model(folder)
    path = folder / f"{PART}{suffix}"
    if suffix is None or not path.is_file():
        return None
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise ValueError(f"{size} bytes, of which at most {LARGEST_FILE} are read")
        points = _READERS[suffix](path)
        _refuse_far(points.positions)
    except (ValueError, OverflowError, OSError) as error:
        raise UserError(
            "the points of a COLMAP model cannot be read",
            where=path,
            found=f"{type(error).__name__}: {error}",
            expected="the points of a COLMAP model, and the photos that see each",
            remedy="Export the model again, or take this file out of its folder to have points triangulated anew.",
        ) from error
    return points


def _refuse_far(positions: Float64[np.ndarray, "P 3"]) -> None:
    near = (np.abs(positions) <= LARGEST_TRANSLATION).all(axis=1)  # NaN is not
    if not near.all():
        row = int(np.argmin(near))
        found = ", ".join(f"{value:g}" for value in positions[row])
        raise ValueError(f"point {row + 1} of {len(positions)} lies at {found}, not within {LARGEST_TRANSLATION:g}")


def _binary_points(path: Path) -> ModelPoints:
    points, views = bytearray(), bytearray()
    with path.open("rb") as file:
        left = path.stat().st_size
        (count,) = COUNT.unpack(_take(file, COUNT.size, left))
        left -= COUNT.size
        if count > left // POINT.itemsize:
            raise ValueError(f"{count} points in {left} bytes, of which each takes {POINT.itemsize} or more")
        for _ in range(count):
            point = _take(file, POINT.itemsize, left)
            left -= POINT.itemsize
            size = VIEW.itemsize * COUNT.unpack_from(point, POINT.itemsize - COUNT.size)[0]
            points += point
            views += _take(file, size, left)
            left -= size
    if left:
        raise ValueError(f"{left} bytes follow its {count} points")
    table = np.frombuffer(points, POINT)
    return ModelPoints(
        positions=table["position"].astype(np.float64),
        colors=table["color"].copy(),
        errors=table["error"].astype(np.float64),
        views=table["views"].astype(np.int64),
        photos=np.frombuffer(views, VIEW)["photo"].astype(np.int64),
    )


def _take(file: BinaryIO, size: int, left: int) -> bytes:
    """`size` bytes of a file with `left` bytes left; raises `ValueError` past the end, before allocating memory."""
    taken = file.read(size) if size <= left else b""
    if len(taken) < size:
        raise ValueError("the file ends too early")
    return taken


def _text_points(path: Path) -> ModelPoints:
    positions, errors, colors = array("d"), array("d"), array("B")
    views, photos = array("q"), array("q")
    for number, line in _lines(path):
        parts = line.split()
        try:
            if len(parts) < NUMBERS_OF_A_POINT or len(parts) % 2:
                raise ValueError(f"{len(parts)} numbers; expected {NUMBERS_OF_A_POINT}, and two for each view")
            positions.extend(map(float, parts[1:4]))
            colors.extend(map(int, parts[4:7]))
            errors.append(float(parts[7]))
            photos.extend(map(int, parts[8::2]))
        except (ValueError, OverflowError) as error:
            raise ValueError(f"line {number}: {error}") from error
        views.append(len(parts) // 2 - NUMBERS_OF_A_POINT // 2)
    return ModelPoints(
        positions=np.array(positions, np.float64).reshape(-1, 3),
        colors=np.array(colors, np.uint8).reshape(-1, 3),
        errors=np.array(errors, np.float64),
        views=np.array(views, np.int64),
        photos=np.array(photos, np.int64),
    )


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines with content, and their numbers; raises `ValueError` for one longer than `LONGEST_LINE`."""
    with path.open("rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE + 1), b""), start=1):
            if len(line) > LONGEST_LINE:
                raise ValueError(f"line {number} is longer than {LONGEST_LINE} bytes")
            text = line.decode("utf-8-sig").strip()
            if text and not text.startswith("#"):
                yield number, text


def points_seen_by(
    points: ModelPoints, photos: Sequence[int], project: Callable[[Float64[np.ndarray, "P 3"]], Int64[np.ndarray, " V"]]
) -> KnownPoints | None:
    """The points that at least one of these photos (distinct image ids) sees; None if there are none.

    Points of which the model lists no view at all, as programs write that do not match photos, are among them. Of
    these, `project` says how many each photo sees.
    """
    numbers = np.array(photos, np.int64)
    ascending = np.argsort(numbers)
    places = np.searchsorted(numbers, points.photos, sorter=ascending).clip(max=len(numbers) - 1)
    rows = ascending[places]
    known = numbers[rows] == points.photos
    seen = np.repeat(np.arange(len(points.positions)), points.views)[known]
    views = np.bincount(seen, minlength=len(points.positions))
    unlisted = points.views == 0
    kept = (views > 0) | unlisted
    if not kept.any():
        return None
    once = np.unique(seen * len(numbers) + rows[known])  # a photo may see a point in two places
    measured = (views > 0) & (points.errors >= 0) & (points.errors <= LARGEST_ERROR)
    error = float(np.average(points.errors[measured], weights=views[measured])) if measured.any() else None
    counts = np.bincount(once % len(numbers), minlength=len(numbers)) + project(points.positions[unlisted])
    return KnownPoints(points.positions[kept], points.colors[kept], counts, error)


_READERS = {".bin": _binary_points, ".txt": _text_points}
