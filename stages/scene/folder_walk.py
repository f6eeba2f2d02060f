"""Walks a folder and everything below it, each folder once: links are followed, and may lead back up."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path


def folders_from(top: Path, enters: Callable[[str], bool]) -> Iterator[tuple[Path, list[str]]]:
    """`top` and the folders below it, each with the names of its files; skips folders whose names `enters` rejects.

    A folder reachable by several names is visited once; among siblings, a real folder takes precedence over a link.
    """
    seen = {os.path.realpath(top)}
    for folder, inner, files in os.walk(top, followlinks=True):
        yield Path(folder), files
        entered = []
        for name in sorted(filter(enters, inner), key=lambda name: (Path(folder, name).is_symlink(), name)):
            real = os.path.realpath(Path(folder, name))
            if real not in seen:
                seen.add(real)
                entered.append(name)
        inner[:] = entered
