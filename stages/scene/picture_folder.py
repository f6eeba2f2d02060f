"""A folder of pictures of any kind to look through: those directly in it, or an error that says where they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import UserError
from stages.scene.photo_folder import (
    PhotoFolder,
    files_below,
    photos_in,
    refuse_unwritten_names,
    unread_among,
    what_is_there,
)
from stages.scene.photos_below import is_photo
from stages.scene.plurals import counted

MOST_NAMED = 5
"""Folders named in an error."""


def find_pictures(folder: Path, suffixes: Sequence[str]) -> PhotoFolder:
    """The pictures directly in a folder. They are not paired by name, so names may differ only in extension.

    Raises `UserError` if there is no folder, or no picture directly in it, and for names that tables cannot hold.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing"
        raise UserError(
            "no such folder of pictures to look through",
            where=folder,
            found=found,
            remedy="Name the folder that holds the pictures.",
        )
    files = [file for file in folder.iterdir() if file.is_file()]
    pictures = photos_in(folder, suffixes)
    if not pictures:
        raise _no_pictures(folder, files, suffixes)
    refuse_unwritten_names(folder, [picture.name for picture in pictures])
    named = {picture.name: picture for picture in pictures}
    return PhotoFolder(named, len(files) - len(pictures), unread=unread_among(files, pictures))


def _no_pictures(folder: Path, files: Sequence[Path], suffixes: Sequence[str]) -> UserError:
    below = Counter(file.parent for file in files_below(folder) if is_photo(file, suffixes)).most_common()
    named = [f"{counted(count, 'picture')} in {place.relative_to(folder).as_posix()}" for place, count in below]
    more = [f"more in {counted(len(named) - MOST_NAMED, 'other folder')}"] if len(named) > MOST_NAMED else []
    return UserError(
        "no pictures to look through lie directly in the folder",
        where=folder,
        found=", ".join([*named[:MOST_NAMED], *more]) or what_is_there(folder),
        expected=f"pictures ({', '.join(suffixes)}) in the folder itself",
        remedy=_how_to_have_pictures([place for place, _ in below], [*unread_among(files, ())]),
    )


def _how_to_have_pictures(places: Sequence[Path], unread: Sequence[str]) -> str:
    convert = f"Convert the pictures ({', '.join(unread)}), which cannot be read, to JPEG. " if unread else ""
    if not places:
        return convert.strip() or "Put the pictures into it, or give another folder."
    one = f"Give that folder: {places[0]}" if len(places) == 1 else "Give one of these, or copy all into one folder."
    return f"{convert}{one}"
