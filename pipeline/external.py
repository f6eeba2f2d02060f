"""What lies outside the store: folders and files that parameters point to, digested by names and bytes."""

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
    """SHA-256 of each file by its name: of all under a folder, with `/`, or of the one file that a path leads to."""

    is_folder: bool
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 of names and bytes. The path that leads there does not enter it, nor do empty folders."""
        if self.is_folder:
            return digest_of({"folder": self.files}, "the folder")
        ((name, content),) = self.files.items()
        return digest_of({"file": name, "bytes": content}, "the file")


def resolved(path: Path) -> Path:
    """Absolute, links followed; as far as that goes for what is no path: too long, a zero byte, a link to itself."""
    try:
        return path.resolve()
    except (OSError, ValueError, RuntimeError):
        return path.absolute()


def from_home(path: str | Path) -> Path:
    """With a ~ at its beginning replaced by a home folder; as it is where nobody of that name has one."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def is_there(path: str | Path) -> bool:
    """Whether a file or folder is there; what is no path leads nowhere."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def _unheard(files: Sequence[Path]) -> None:
    """For who does not ask what will be read."""


def contents_of(
    path: Path,
    digest_file: Callable[[Path], str] = digest_of_file,
    listed: Callable[[Sequence[Path]], None] = _unheard,
) -> Contents:
    """What is at `path`; links are followed. `listed` hears of all files before the first of them is read.

    Raises UserError for what cannot be read, or would be waited for.
    """
    try:
        if path.is_dir():
            files = _files_under(path)
            listed(files)
            return Contents(True, {file.relative_to(path).as_posix(): digest_file(file) for file in files})
        if not stat.S_ISREG(path.stat().st_mode):
            raise UserError("is neither a file nor a folder", where=path, remedy="Copy what it gives into a file.")
        listed([path])
        return Contents(False, {path.name: digest_file(path)})
    except OSError as error:
        raise UserError("cannot be read", where=error.filename or path, found=error.strerror) from error


def _files_under(folder: Path) -> list[Path]:
    files = []
    for name, _, names in os.walk(folder, followlinks=True, onerror=_raise):
        directory = Path(name)
        above = list(takewhile(lambda parent: parent.is_relative_to(folder), directory.parents))
        # What leads above where it stands, as to /, comes round only after all that is there.
        here = directory.resolve()
        if any(parent.resolve().is_relative_to(here) for parent in above):
            raise UserError("a link leads round in a circle", where=directory)
        files += [directory / file for file in names]
    for file in files:
        if not file.is_file():
            raise UserError("is neither a file nor a folder", where=file, remedy="Remove it or repair the link.")
    return files


def _raise(error: OSError) -> None:
    raise error
