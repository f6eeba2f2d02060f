"""Where private artifacts may be written: only where nobody else would come by them.

A private place is one that others cannot enter, since the folder itself or one above it belongs to the user and is
closed to all others (mode 0700), and that is not published by accident, since it is in no git work tree.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from pipeline.artifact import Artifact
from pipeline.errors import CommandError
from pipeline.external import resolved


def why_public(path: Path) -> str | None:
    """Why what is written to `path` would be in a public place, in words; None for a private place.

    Looks at the folders above `path`, and at `path` itself, as far as they exist.
    """
    path = resolved(path)  # of new/../x too, where new is not there yet and x elsewhere than it seems
    existing = next(folder for folder in (path, *path.parents) if folder.is_dir())
    folders = [existing, *existing.parents]
    for folder in folders:
        if (folder / ".git").exists():
            return f"it is in the git work tree {folder}"
    return None if any(_closed(folder) for folder in folders) else f"others can enter {existing}"


def check_place(artifact: Artifact, path: Path, reveal: bool) -> None:
    """Raises CommandError for a private artifact that would go to a public place, unless told to `reveal` it."""
    if not artifact.private or reveal:
        return
    reason = why_public(path)
    if reason:
        raise CommandError(
            f"this {artifact.kind} is private, and that is a public place: {reason}",
            where=path,
            expected="a folder that only you can enter (mode 0700) and that is in no git work tree",
            remedy="Choose another (mkdir -m 700 FOLDER), or add --reveal to write it there all the same.",
        )


def make_folder(path: Path, private: bool) -> None:
    """Makes a folder with its parents where it is missing; those of private artifacts are closed to others."""
    for folder in reversed([path, *path.parents]):
        if not folder.is_dir():
            folder.mkdir(mode=0o700 if private else 0o777, exist_ok=True)


@contextmanager
def new_file(path: Path, private: bool) -> Iterator[IO[bytes]]:
    """A file in place of any that is there; nobody else can read a private one, at no time."""
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o666)
    with os.fdopen(descriptor, "wb") as file:
        yield file


def _closed(folder: Path) -> bool:
    """Whether a folder belongs to the user and to nobody else."""
    state = folder.stat()
    return state.st_uid == os.geteuid() and not state.st_mode & 0o077
