"""The photos that a file of poses names by their paths, anywhere in the capture's folder."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from unicodedata import normalize

from pipeline.errors import UserError
from stages.scene.given_poses import MOST
from stages.scene.photo_folder import SUFFIXES, PhotoFolder, find_photos, named_photos
from stages.scene.transforms import frame_files


def find_posed_photos(folder: Path, file: Path) -> PhotoFolder:
    """The photos of a `folder` whose poses are in the transforms.json `file`.

    These are what `find_photos` finds, unless most photos that the frames name exist (`MOST` of them, as for any poses)
    and some are not among these: they may be in a folder of any name, such as undistorted ones beside the originals.
    Raises `UserError` as `find_photos` does.
    """
    named = _named(folder, file)
    try:
        found = find_photos(folder)
    except UserError:
        if named:
            return PhotoFolder(named, 0)
        raise
    known = {*found.photos.values()}
    if known.issuperset(named.values()):
        return found
    return PhotoFolder(named, 0, tuple(sorted(known.difference(named.values()))))


def _named(folder: Path, file: Path) -> dict[str, Path]:
    """The photos of all frames by file name, sorted; empty unless most of them exist.

    None do if the paths are those of the machine that wrote the file.
    """
    frames = dict.fromkeys(frame_files(file))
    photos = photos_there(folder, file, frames)
    return under_one_folder(photos) if len(photos) >= MOST * len(frames) else {}


def photos_there(folder: Path, file: Path, frames: Iterable[str]) -> list[Path]:
    """The photos that exist of those that frames of `file` name, in this order, each once."""
    photos: dict[Path, None] = {}
    for frame in frames:
        with suppress(UserError):
            photos[photo_of_frame(folder, file, frame)] = None
    return [*photos]


def under_one_folder(photos: Sequence[Path]) -> dict[str, Path]:
    """The photos as `named_photos` names them from their common folder; empty if there are none."""
    return named_photos(Path(os.path.commonpath([photo.parent for photo in photos])), photos) if photos else {}


def photo_of_frame(folder: Path, file: Path, frame: str) -> Path:
    """The photo that a frame of `file` names by a path from `folder`.

    The path may omit the extension, and write accented letters composed or decomposed. Raises `UserError` if the photo
    is missing, or outside `folder`, where it could change unnoticed.
    """
    inside = not Path(frame).is_absolute() and ".." not in Path(frame).parts
    endings = ("", *SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))
    written = dict.fromkeys((frame, normalize("NFC", frame), normalize("NFD", frame)))
    candidates = [folder / f"{path}{suffix}" for path in written for suffix in endings]
    candidates = candidates if inside and "\0" not in frame else []
    for candidate in candidates:
        if candidate.suffix.lower() in SUFFIXES and _is_file(candidate):
            return candidate
    raise UserError(
        "the poses refer to photos that do not exist",
        where=file,
        found=repr(frame[:80]),
        expected=f"a file_path of a photo in the capture's folder, with or without {', '.join(SUFFIXES)}",
        remedy="Put the photo there, or take the frame out.",
    )


def _is_file(candidate: Path) -> bool:
    try:
        return candidate.is_file()
    except OSError:  # a name too long for the file system
        return False
