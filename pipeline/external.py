"""What lies outside the store: folders and files that parameters point to, digested by names and bytes."""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.canonical import digest_of, digest_of_file
from pipeline.errors import UserError


def digest_of_external(path: Path) -> str:
    """SHA-256 of a file's name and bytes, or of the names and bytes of all files under a folder; links are followed.

    The path that leads there does not enter it. Raises UserError for what cannot be read.
    """
    try:
        if path.is_dir():
            files = {file.relative_to(path).as_posix(): digest_of_file(file) for file in _files_under(path)}
            return digest_of({"folder": files})
        return digest_of({"file": path.name, "bytes": digest_of_file(path)})
    except OSError as error:
        raise UserError("cannot be read", where=error.filename or path, found=error.strerror) from error


def _files_under(folder: Path) -> list[Path]:
    files = []
    for name, _, names in os.walk(folder, followlinks=True, onerror=_raise):
        directory = Path(name)
        above = [parent.resolve() for parent in directory.parents if parent.is_relative_to(folder)]
        if directory.resolve() in above:
            raise UserError("a link leads round in a circle", where=directory)
        files += [directory / file for file in names]
    for file in files:
        if not file.is_file():
            raise UserError("is neither a file nor a folder", where=file, remedy="Remove it or repair the link.")
    return files


def _raise(error: OSError) -> None:
    raise error
