"""Digests of external files, cached by how each file looked when it was read, so that no plan reads it again.

    cache/external/<hash of the path>.json   for each folder or file that a workflow names: what its files looked like
    external/<digest>.json                   the names and digests behind a digest, for `explain`

See `look` for when a file counts as unchanged; a file that has only just changed is not cached.

Names of files may reveal a message, so nobody else can read either. A file is replaced as a whole; if two processes do
so at the same time, the last one wins, and its content is as true as the other's.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from hashlib import file_digest, sha256
from pathlib import Path
from typing import TextIO

from pipeline.errors import UserError
from pipeline.store.checksummed import read_checksummed, with_checksum, write_text_whole
from pipeline.store.external import Contents, contents_of, resolved
from pipeline.store.look import Look, is_settled, look_of
from pipeline.store.reading import Reading
from pipeline.store.store import Store

TRIES = 3

Memory = dict[str, tuple[Look, str]]


class ExternalCache:
    """The digests of what is outside `store`. Reports the progress of a long reading on `stream`, if there is one."""

    def __init__(self, store: Store, stream: TextIO | None = None) -> None:
        self._store = store
        self._stream = stream

    def digest(self, path: Path) -> str:
        """The digest of a file or folder, as in `Contents`. What was read stays cached even if Ctrl-C ends the reading.

        Raises UserError for what cannot be read, and for a folder that contains the store: every run would find it
        changed, and stages would read their own results.
        """
        if resolved(self._store.root).is_relative_to(resolved(path)):
            raise UserError(
                "contains the store, which changes while stages run",
                where=path,
                found=self._store.root,
                remedy="Put the store elsewhere, with --store, or give a folder that does not contain it.",
            )
        place = self._store.root / "cache" / "external" / f"{sha256(os.fsencode(path)).hexdigest()}.json"
        before, after = _read_memory(place), Memory()
        reading = Reading(path, self._stream)

        def digest_file(file: Path) -> str:
            digest = _digest(file, before, after)
            reading.one_done()
            return digest

        try:
            contents = contents_of(path, digest_file, reading.listed)
        except BaseException:
            self._remember(place, before, before | after)
            raise
        finally:
            reading.close()
        self._remember(place, before, after)
        digest = contents.digest
        listing = self._listing(digest)
        if not listing.is_file():
            self._write(listing, {"folder": contents.is_folder, "files": contents.files})
        return digest

    def contents(self, digest: str) -> Contents | None:
        """The names and digests of the files behind a digest; None if they are unknown."""
        content = read_checksummed(self._listing(digest))
        return Contents(content["folder"], content["files"]) if content else None

    def _remember(self, place: Path, before: Memory, after: Memory) -> None:
        if after != before:
            self._write(place, {name: [*look, digest] for name, (look, digest) in after.items()})

    def _listing(self, digest: str) -> Path:
        return self._store.root / "external" / f"{digest}.json"

    def _write(self, path: Path, content: Mapping[str, object]) -> None:
        with suppress(OSError):  # the store may be read-only, and a full disk is no reason to fail
            aside = self._store.temporary()
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_text_whole(path, with_checksum(content), aside, mode=0o600)


def _digest(path: Path, before: Memory, after: Memory) -> str:
    """SHA-256 of a file, from the cached `before` if it looks the same; what may be cached is added to `after`.

    Raises UserError if the file keeps changing while it is read.
    """
    name = str(path)
    look = look_of(path.stat())
    remembered = before.get(name)
    if remembered and remembered[0] == look:
        after[name] = remembered
        return remembered[1]
    for _ in range(TRIES):
        with path.open("rb") as file:
            look = look_of(os.fstat(file.fileno()))
            began = time.time_ns()
            digest = file_digest(file, "sha256").hexdigest()
            unchanged = look == look_of(os.fstat(file.fileno()))
        if unchanged:
            if is_settled(look, began):
                after[name] = look, digest
            return digest
    raise UserError("changed while it was being read", where=path, remedy="Try again when nothing is writing to it.")


def _read_memory(path: Path) -> Memory:
    """What was cached; empty if the file is missing or damaged."""
    content = read_checksummed(path) or {}
    try:
        return {name: (tuple(map(int, entry[:-1])), str(entry[-1])) for name, entry in content.items()}
    except (TypeError, ValueError, IndexError):
        return {}
