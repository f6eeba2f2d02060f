"""Reading cameras from bundles from any source; errors say which camera is invalid, but quote none of its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Float64

from pipeline.errors import UserError
from stages.hiding.bundle import CAMERAS, IMAGE_CAMERA
from stages.hiding.bundle_files import check_format, json_of, text_of
from stages.hiding.camera_files import CAMERAS_FORMAT, MOST_CAMERAS, calibration
from stages.scene.camera_checks import are_cameras
from stages.scene.cameras import Cameras

COUNTS = {CAMERAS: range(2, MOST_CAMERAS + 1), IMAGE_CAMERA: range(1, 2)}
"""How many cameras each file may hold: a path has a beginning and an end, a hidden image exactly one camera."""
LARGEST_SIDE = 8192  # pixels
SHORTEST_LENS, LONGEST_LENS = 0.05, 200.0
"""Focal lengths, relative to the picture's long side: fields of view of about 170 degrees and of a quarter of a
degree."""
FARTHEST = 1e9
"""Largest magnitude of a pose's numbers, in world units: the same limit as for the means of Gaussians."""


def read_cameras_file(place: Path, name: str) -> Cameras | None:
    """The cameras in the file `name` of a bundle's folder, named by their numbers; None if there is no such file.

    Raises `UserError` for anything that is not a camera. The error says which camera is wrong, but quotes no number,
    since the file may belong to a secret.
    """
    path = place / name
    if not path.exists():
        return None
    description = json_of(path, text_of(place, name))
    check_format(path, description, CAMERAS_FORMAT)
    width, height = _size(path, description)
    poses = _poses(path, description, COUNTS[name])
    lens = _lens(path, description, width, height)
    names = tuple(f"{number:04d}" for number in range(len(poses)))
    cameras = Cameras(names, poses, np.tile(lens, (len(poses), 1, 1)), width, height)
    good = are_cameras(cameras)
    if not good.all():
        raise _wrong(path, f"a camera that is no rotation and place, number {int(np.argmin(good))}", "rotations")
    return cameras


def _size(path: Path, description: Mapping[str, Any]) -> tuple[int, int]:
    match description:
        case {"width": int(width), "height": int(height)} if (
            type(width) is type(height) is int and min(width, height) > 0 and max(width, height) <= LARGEST_SIDE
        ):
            return width, height
    raise _wrong(path, "no size of pictures", f"width and height from 1 to {LARGEST_SIDE}")


def _lens(path: Path, description: Mapping[str, Any], width: int, height: int) -> Float64[np.ndarray, "3 3"]:
    side = max(width, height)
    values = description.get("lens")
    if not _are_numbers(values, 4, LONGEST_LENS * side) or min(values[:2]) < SHORTEST_LENS * side:
        raise _wrong(path, "no lens", f"focal lengths from {SHORTEST_LENS:g} to {LONGEST_LENS:g} times the long side")
    return calibration(*map(float, values))


def _poses(path: Path, description: Mapping[str, Any], counts: range) -> Float64[np.ndarray, "V 4 4"]:
    rows = description.get("world_to_camera")
    if not isinstance(rows, list) or len(rows) not in counts:
        found = f"{len(rows)} of them" if isinstance(rows, list) else "no list of them"
        several = f"from {counts[0]} to {counts[-1]}" if len(counts) > 1 else "one alone"
        raise _wrong(path, found, several)
    for number, row in enumerate(rows):
        if not _are_numbers(row, 12, FARTHEST):
            raise _wrong(path, f"a camera that is none, number {number}", f"12 numbers, none beyond {FARTHEST:g}")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array(rows, np.float64).reshape(-1, 3, 4)
    return poses


def _are_numbers(values: Any, count: int, largest: float) -> TypeGuard[list[float]]:
    """Whether `values` is a list of `count` finite numbers up to `largest`; NaN fails every comparison."""
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(value) in (int, float) and abs(value) <= largest for value in values)


def _wrong(path: Path, found: str, expected: str) -> UserError:
    return UserError(
        "invalid cameras",
        where=path,
        found=found,
        expected=expected,
        remedy="Fetch the file again from where the bundle came from.",
    )
