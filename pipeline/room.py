"""Whether the store's disk has room for a run: what fills it hours later had better be known before."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.disk import free_bytes, size_words
from pipeline.graph import Node
from pipeline.store import Store

RESULTS = 10**9
"""Bytes for what is made of photos, in small."""


def lacking_room(nodes: Iterable[Node], store: Store) -> str | None:
    """What a person should know where these stages may not find room in the store; None where there is enough.

    They copy what they take from outside, all or much of it; what else they make nobody knows before.
    """
    free = free_bytes(store.root)
    copied = sum(map(_bytes_at, {path for node in nodes for path in node.outside_paths}))
    if free is None or free >= RESULTS + copied:
        return None
    there = f"the disk that holds {store.root} has {size_words(free)} free"
    copies = f", {size_words(copied)} of them copies of photos and other files" if copied else ""
    return f"{there}; this run may take {size_words(RESULTS + copied)}{copies}"


def _bytes_at(path: str) -> int:
    """Bytes of a file, or of all under a folder; links are followed, as by who copies."""
    files = [Path(folder, name) for folder, _, names in os.walk(path, followlinks=True) for name in names]
    return sum(map(_size, files or [Path(path)]))


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0
