"""What digests in the parts of a key stand for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.store.external import Contents
from pipeline.store.external_cache import ExternalCache
from pipeline.store.store import Store


class Known:
    """What the store knows about digests of code and of external files, each looked up once."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._external = ExternalCache(store)
        self._codes: dict[str, Mapping[str, Any] | None] = {}
        self._files: dict[str, Contents | None] = {}

    def code(self, digest: str) -> Mapping[str, Any] | None:
        """The modules that a digest of code stands for: see `Store.code`. None if unknown."""
        if digest not in self._codes:
            self._codes[digest] = self._store.code(digest)
        return self._codes[digest]

    def files(self, digest: str) -> Contents | None:
        """The external files that a digest stands for; None if unknown."""
        if digest not in self._files:
            self._files[digest] = self._external.contents(digest)
        return self._files[digest]
