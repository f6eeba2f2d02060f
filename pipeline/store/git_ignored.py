"""Makes git ignore a folder: in a work tree, secrets would otherwise be committed along with all that is new."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

IGNORED = ".gitignore"
EVERYTHING = b"# Results, private ones among them.\n*\n"


def make_git_ignore(folder: Path) -> None:
    """Writes a `.gitignore` that covers everything, unless there is one already: the user may have changed it.

    Does nothing if the folder cannot be written: it may be another user's.
    """
    path = folder / IGNORED
    with suppress(OSError):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(EVERYTHING)
        except OSError:  # a full disk, on which an empty file would be left
            path.unlink()
