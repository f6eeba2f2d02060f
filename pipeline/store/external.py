"""What is outside the store: folders and files that parameters point to, digested by names and bytes."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from pipeline.canonical import digest_of, digest_of_file
from pipeline.errors import UserError


@dataclass(frozen=True)
class Contents:
    """SHA-256 of each file by name: of all files under a folder, named with `/`, or of a single file."""

    is_folder: bool
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 of names and bytes. It does not depend on the path to them, nor on empty folders."""
        if self.is_folder:
            return digest_of({"folder": self.files}, "the folder")
        ((name, content),) = self.files.items()
        return digest_of({"file": name, "bytes": content}, "the file")


def resolved(path: Path) -> Path:
    """The absolute path, with links followed.

    Only made absolute if it cannot be resolved: too long, with a zero byte, or a link to itself.
    """
    try:
        return path.resolve()
    except (OSError, ValueError, RuntimeError):
        return path.absolute()


def from_home(path: str | Path) -> Path:
    """The path with a leading ~ replaced by a home folder; unchanged if there is no such user."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def is_there(path: str | Path) -> bool:
    """Whether a file or folder exists; False for what cannot be a path."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def _unheard(files: Sequence[Path]) -> None:
    """For callers that do not ask what will be read."""


def contents_of(
    path: Path,
    digest_file: Callable[[Path], str] = digest_of_file,
    listed: Callable[[Sequence[Path]], None] = _unheard,
) -> Contents:
    """The contents of a file or folder; links are followed. `listed` is called with all files before the first is read.

    Raises UserError for what cannot be read or would block, and for links that lead round in a circle.
    """
    try:
        if path.is_dir():
            files = _files_under(path)
            listed(files)
            return Contents(True, {file.relative_to(path).as_posix(): digest_file(file) for file in files})
        if not stat.S_ISREG(path.stat().st_mode):
            raise UserError("is neither a file nor a folder", where=path, remedy="Copy its contents into a file.")
        listed([path])
        return Contents(False, {path.name: digest_file(path)})
    except OSError as error:
        raise UserError(
            "cannot be read", where=error.filename or path, found=error.strerror, remedy=_way_out(error)
        ) from error


def _way_out(error: OSError) -> str:
    if isinstance(error, PermissionError):
        return "Give yourself the right to read it (chmod u+r; for a folder, u+rx), or take it out of there."
    return "Check the path; if the file is there, replace it, or take it out of there."


def _files_under(folder: Path) -> list[Path]:
    files = []
    for name, _, names in os.walk(folder, followlinks=True, onerror=_raise):
        directory = Path(name)
        above = list(takewhile(lambda parent: parent.is_relative_to(folder), directory.parents))
        # A link to a folder above, such as /, would otherwise come round only after everything in it.
        here = directory.resolve()
        if any(parent.resolve().is_relative_to(here) for parent in above):
            raise UserError("a link leads back to a folder above it", where=directory, remedy="Remove the link.")
        files += [directory / file for file in names]
    for file in files:
        if not file.is_file():
            raise UserError("is neither a file nor a folder", where=file, remedy="Remove it or repair the link.")
    return files


def _raise(error: OSError) -> None:
    raise error
