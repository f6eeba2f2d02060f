"""The points that a transforms.json names (`ply_file_path`), as nerfstudio writes them: a PLY with colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.errors import UserError
from pipeline.plain_text import listed
from stages.scene.colmap import LARGEST_TRANSLATION, PosedPhoto
from stages.scene.known_points import KnownPoints
from stages.scene.ply.reading import Ply, read_ply, types_of
from stages.scene.transforms import points_file

GREY = 128
"""Channel value of points without colours."""
COUNTED = 20_000
"""Points, at most, that are sampled evenly from the file to estimate how many points each photo sees."""
REMEDY = "Write the file again, or take ply_file_path out of the file of poses to have points triangulated."


def points_of_transforms(path: Path, posed: Sequence[PosedPhoto], folder: Path) -> KnownPoints | None:
    """The points that the transforms.json at `path` names, in the world of its frames; None if it names none.

    None also if their file has no points, is missing, or lies outside `folder`, where it could change unnoticed. It
    does not state which photos see a point: here, those into whose picture it projects, ignoring distortion and
    occlusion. Raises `UserError` for a file that cannot be read.
    """
    named = points_file(path)
    file = _inside(path.parent / named, folder) if named else None
    return None if file is None else points_of_ply(file, posed)


def _inside(path: Path, folder: Path) -> Path | None:
    """The file at `path` if there is one within `folder`; a hostile file of poses may name anything."""
    try:
        file = path.resolve()
        return file if file.is_file() and file.is_relative_to(folder.resolve()) else None
    except (OSError, ValueError, RuntimeError):  # too long, a null byte, or links that lead round in a circle
        return None


def points_of_ply(file: Path, posed: Sequence[PosedPhoto]) -> KnownPoints | None:
    """The points of a PLY in the world of these photos, as `points_of_transforms` reads them; None if it has none."""
    ply = read_ply(file)
    positions, colors = _positions(ply), _colors(ply)
    return KnownPoints(positions, colors, seen_by_projection(posed, positions), None) if len(positions) else None


def _positions(ply: Ply) -> Float64[np.ndarray, "P 3"]:
    rows = _vertices(ply, ("x", "y", "z"), (np.dtype(np.float32), np.dtype(np.float64)))
    positions = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
    near = (np.abs(positions) <= LARGEST_TRANSLATION).all(axis=1)  # NaN is not
    if not near.all():
        row = int(np.argmin(near))
        raise UserError(
            f"point {row} of a PLY is outside any plausible scene",
            where=ply.path,
            found=", ".join(f"{value:g}" for value in positions[row]),
            expected=f"finite numbers within {LARGEST_TRANSLATION:g}",
            remedy=REMEDY,
        )
    return positions


def _colors(ply: Ply) -> UInt8[np.ndarray, "P 3"]:
    names = ("red", "green", "blue")
    if types_of(ply.rows("vertex").dtype).keys().isdisjoint(names):
        return np.full((len(ply.rows("vertex")), 3), GREY, np.uint8)
    rows = _vertices(ply, names, (np.dtype(np.uint8),))
    return np.stack([rows[name] for name in names], axis=1)


def _vertices(ply: Ply, names: Sequence[str], types: Sequence[np.dtype]) -> np.ndarray:
    """The rows. Raises `UserError` unless they have these properties, each of one of these types."""
    rows = ply.rows("vertex")
    found = types_of(rows.dtype)
    for name in names:
        if found.get(name) not in types:
            raise UserError(
                f"the points that a file of poses names have no usable {name}",
                where=ply.path,
                found=str(found.get(name, f"no {name} among {listed(list(found))}")),
                expected=" or ".join(str(each) for each in types),
                remedy=REMEDY,
            )
    return rows


def seen_by_projection(posed: Sequence[PosedPhoto], positions: Float64[np.ndarray, "P 3"]) -> Int64[np.ndarray, " V"]:
    """About how many of the points project into the picture of each photo. Zeros if there are no points."""
    every = max(1, -(-len(positions) // COUNTED))
    sample = positions[::every]
    return np.array([every * _within(photo, sample) for photo in posed], np.int64).clip(max=len(positions))


def _within(photo: PosedPhoto, positions: Float64[np.ndarray, "P 3"]) -> int:
    """How many points are in front of the camera and project into its picture."""
    rotation, translation = photo.world_to_camera[:3, :3], photo.world_to_camera[:3, 3]
    at_camera = positions @ rotation.T + translation
    pixels = (at_camera[at_camera[:, 2] > 0] @ photo.lens.matrix().T).T
    across, down = pixels[:2] / pixels[2]
    return int(((across >= 0) & (across <= photo.lens.width) & (down >= 0) & (down <= photo.lens.height)).sum())
