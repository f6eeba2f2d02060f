"""Has git pass over a folder: in a work tree, secrets would be committed with all that is new."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

IGNORED = ".gitignore"
EVERYTHING = b"# Results, private ones among them.\n*\n"


def hide_from_git(folder: Path) -> None:
    """What a user says there instead stays. Where nothing can be written nothing is: a reader may be another user."""
    path = folder / IGNORED
    with suppress(OSError):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(EVERYTHING)
        except OSError:  # a full disk, where an empty one would stay
            path.unlink()
