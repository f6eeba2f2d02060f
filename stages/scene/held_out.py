"""The photos that a capture holds out for testing, as the files beside its poses say."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from pipeline.errors import UserError
from stages.scene.colmap import FOLDERS
from stages.scene.given_poses import photo_finder
from stages.scene.transforms import FILE, held_out_files

LIST = "test.txt"
"""File beside a COLMAP model, with the name of a test photo in each line, as 3DGS reads it."""
MOST_NAMED = 3
"""Largest number of names in an error."""


def held_out_photos(
    place: Path, folders: Sequence[Path], photos: Collection[str], missing: Collection[str]
) -> frozenset[str]:
    """Those of `photos` that are held out by the files beside the poses at `place`; empty if none are.

    A transforms.json holds out its `test_filenames`. A COLMAP model has such a file in one of `folders`, as nerfstudio
    leaves it there, or a test.txt in one of them, or where a first model in it would be. If several files name photos,
    all of these are held out, as none may be trained on. Posed photos that are `missing` may be named: their poses are
    left out. Raises `UserError` for a file that cannot be read, and for names that are of no photo.
    """
    held_out: set[str] = set()
    for file in _files(place, folders):
        listed = _listed(file) if file.name == LIST else held_out_files(file)
        held_out |= _photos_named(file, listed, photos, missing)
    return frozenset(held_out)


def _files(place: Path, folders: Sequence[Path]) -> list[Path]:
    """The files that may hold out photos; those beside a model only if they exist."""
    if not place.is_dir():
        return [place]
    models = [place, *(folder / name.replace("*", "0") for folder in folders for name in FOLDERS)]
    files = [*(model / LIST for model in models), *(folder / FILE for folder in folders)]
    return [file for file in dict.fromkeys(files) if file.is_file()]


def _listed(file: Path) -> list[str]:
    """The lines of a file, without empty ones."""
    try:
        lines = file.read_text("utf-8-sig").split("\n")
    except (ValueError, OSError) as error:
        raise UserError(
            "a list of test photos cannot be read",
            where=file,
            found=f"{type(error).__name__}: {error}",
            expected="the name of a photo in each line, in UTF-8",
            remedy="Repair the file, or take it out of the folder.",
        ) from error
    return [line.strip() for line in lines if line.strip()]


def _photos_named(file: Path, listed: Sequence[str], photos: Collection[str], missing: Collection[str]) -> set[str]:
    photo_named = photo_finder(photos, file)
    missing_named = photo_finder(["_".join(Path(name).parts) for name in missing], file)
    named = {name: photo_named(name) for name in listed}
    unknown = [name for name, photo in named.items() if photo is None and missing_named(name) is None]
    if unknown:
        raise UserError(
            "the file holds out photos that do not exist",
            where=file,
            found=f"{len(unknown)} of {len(named)}: {', '.join(unknown[:MOST_NAMED])}",
            expected=f"names of the {len(photos)} photos, such as {min(photos)}",
            remedy="Correct the names, or take the file out of the folder if it is not about these photos.",
        )
    return {photo for photo in named.values() if photo is not None}
