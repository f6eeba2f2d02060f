"""Whether the folders of a store can be listed at all: `gc` must not take what it may not see for nothing."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.disk import entries_of
from pipeline.errors import UserError


def refuse_unlisted(root: Path, folders: Iterable[str]) -> None:
    """Raises UserError if one of these folders under `root`, or one in them, is there and cannot be listed.

    `entries_of` takes such a folder for an empty one, as another user's may be.
    """
    for name in folders:
        for folder in [root / name, *(Path(entry.path) for entry in entries_of(root, name))]:
            try:
                if folder.is_dir():
                    os.scandir(folder).close()
            except FileNotFoundError:
                continue
            except OSError as error:
                raise UserError(
                    "a folder of the store cannot be listed, so nobody knows what it keeps",
                    where=folder,
                    found=error.strerror,
                    remedy="Nothing was deleted. Run this as the user whose folder it is.",
                ) from error
