"""Where private artifacts may be written: only where nobody else can get at them.

In a private place, others cannot enter, because the folder or one above it belongs to the user and is closed to all
others (mode 0700), and nothing is published by accident, because no folder above is a git work tree.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from pipeline.artifact import Artifact
from pipeline.errors import CommandError
from pipeline.store.external import resolved


def why_public(path: Path) -> str | None:
    """Why a file at `path` would be in a public place, in words; None for a private place.

    Looks at `path` and the folders above it, as far as they exist.
    """
    path = resolved(path)  # also new/../x, where new does not exist yet and x is not where it seems to be
    existing = next(folder for folder in (path, *path.parents) if folder.is_dir())
    folders = [existing, *existing.parents]
    for folder in folders:
        if (folder / ".git").exists():
            return f"it is in the git work tree {folder}"
    return None if any(_closed(folder) for folder in folders) else f"others can enter {existing}"


def check_place(artifact: Artifact, path: Path, reveal: bool) -> None:
    """Raises CommandError if a private artifact would go to a public place, unless it may be revealed (`reveal`)."""
    if not artifact.private or reveal:
        return
    reason = why_public(path)
    if reason:
        raise CommandError(
            f"this {artifact.kind} is private, but that is a public place: {reason}",
            where=path,
            expected="a folder that only you can enter (mode 0700) and that is not in a git work tree",
            remedy="Make one (mkdir -m 700 FOLDER) and give FOLDER/NAME, or add --reveal to write it there anyway.",
        )


def make_folder(path: Path, private: bool) -> None:
    """Creates a folder and its parents if they are missing; for private artifacts, they are closed to others."""
    for folder in reversed([path, *path.parents]):
        if not folder.is_dir():
            folder.mkdir(mode=0o700 if private else 0o777, exist_ok=True)


@contextmanager
def new_file(path: Path, private: bool) -> Iterator[IO[bytes]]:
    """Opens a new file, replacing any other; at no time can anyone else read a private one."""
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o666)
    with os.fdopen(descriptor, "wb") as file:
        yield file


def _closed(folder: Path) -> bool:
    """Whether a folder belongs to the user and is closed to all others."""
    state = folder.stat()
    return state.st_uid == os.geteuid() and not state.st_mode & 0o077
