"""Whether the store's disk has room for a run: better to know before than when it is full hours later."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.disk import free_bytes, size_at, size_words
from pipeline.store.store import Store
from pipeline.workflow.graph import Node

RESULTS = 10**9
"""Bytes allowed for what stages make from their photos, at a small size."""


def lacking_room(nodes: Iterable[Node], store: Store) -> str | None:
    """A warning if these stages may not find room in the store; None if they will, or if the free space is unknown.

    They copy all or much of the external files that they take; how much else they make cannot be known in advance.
    """
    free = free_bytes(store.root)
    copied = sum(map(_bytes_at, {path for node in nodes for path in node.outside_paths}))
    if free is None or free >= RESULTS + copied:
        return None
    there = f"the disk that holds {store.root} has {size_words(free)} free"
    copies = f", {size_words(copied)} of it for copies of photos and other files" if copied else ""
    return f"{there}; this run may need {size_words(RESULTS + copied)}{copies}"


def _bytes_at(path: str) -> int:
    """Bytes of a file, or of all files under a folder; links are followed, as they are in copying."""
    files = [Path(folder, name) for folder, _, names in os.walk(path, followlinks=True) for name in names]
    return sum(map(size_at, files or [Path(path)]))
