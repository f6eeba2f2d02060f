"""What the source files of stages contain, cached so that no plan has to parse a hundred of them again.

    cache/sources/<name>.json   the modules of one package, for one version of Python and of our code that reads them

A module is cached with the looks of all files that were read for it: its own and its resources. For when a look is
trusted, see `look`. The module is read again if one of them looks different, or if its patterns match other files.

A process replaces the whole file at once. Of two at the same time, the last one's cache stays, which is as good as the
other's.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.canonical import digest_of, digest_of_file
from pipeline.code import fingerprint
from pipeline.code.fingerprint import Module, read_module, resource_files
from pipeline.errors import UserError
from pipeline.store.checksummed import read_checksummed, with_checksum, write_text_whole
from pipeline.store.look import Look, is_settled, look_of
from pipeline.store.store import Store


@dataclass(frozen=True)
class Entry:
    """A module, and the looks of its files by path."""

    module: Module
    looks: Mapping[str, Look]

    @property
    def is_current(self) -> bool:
        """Whether every file that was read for the module still looks the same."""
        try:
            files = [self.module.path, *resource_files(self.module.resources, self.module.path)]
            return self.looks == {str(file): look_of(file.stat()) for file in files}
        except (OSError, UserError):
            return False


class SourceCache:
    """The modules of `package`, and those of other packages that its stages import."""

    def __init__(self, store: Store, package: str) -> None:
        self.store = store
        self._package = package
        self._entries: dict[str, Entry] | None = None
        self._new = False

    def module(self, name: str, path: Path) -> Module:
        """The module `name` in the file at `path`, as `read_module` returns it. Raises what that raises."""
        entries = self._known()
        found = entries.get(name)
        if found and found.module.path == path and found.is_current:
            return found.module
        reader = _Reader()
        module = read_module(name, path, reader.read)
        if reader.is_settled:
            entries[name] = Entry(module, reader.looks)
            self._new = True
        return module

    def remember(self) -> None:
        """Writes what was read anew into the store's cache, if the store can be written."""
        if not self._new:
            return
        content = {name: _as_json(entry) for name, entry in self._known().items() if entry.module.path.is_file()}
        with suppress(OSError):  # a store that cannot be written can still be read
            self.store.folder("cache", "sources")
            write_text_whole(self._file(), with_checksum(content), self.store.temporary(), mode=0o600)
        self._new = False

    def _known(self) -> dict[str, Entry]:
        if self._entries is None:
            self._entries = _entries(read_checksummed(self._file()) or {})
        return self._entries

    def _file(self) -> Path:
        reading = [sys.version, digest_of_file(Path(fingerprint.__file__)), digest_of_file(Path(__file__))]
        return self.store.root / "cache" / "sources" / f"{digest_of([self._package, *reading])}.json"


class _Reader:
    """Reads files and records how they looked; `is_settled` is true as long as all these looks can be trusted."""

    def __init__(self) -> None:
        self.looks: dict[str, Look] = {}
        self.is_settled = True
        self._began = time.time_ns()

    def read(self, path: Path) -> bytes:
        with path.open("rb") as file:
            look = look_of(os.fstat(file.fileno()))
            content = file.read()
            unchanged = look == look_of(os.fstat(file.fileno()))
        self.looks[str(path)] = look
        self.is_settled = self.is_settled and unchanged and is_settled(look, self._began)
        return content


def _as_json(entry: Entry) -> dict[str, Any]:
    module = entry.module
    return {
        "path": str(module.path),
        "digest": module.digest,
        "definitions": dict(module.definitions),
        "imports": module.imports,
        "dynamic": module.dynamic,
        "resources": module.resources,
        "looks": dict(entry.looks),
    }


def _entries(content: Mapping[str, Any]) -> dict[str, Entry]:
    """What was cached; empty if it is not in our format."""
    try:
        return {name: Entry(_module(entry), _looks(entry["looks"])) for name, entry in content.items()}
    except (TypeError, ValueError, KeyError, AttributeError):
        return {}


def _module(entry: Mapping[str, Any]) -> Module:
    return Module(
        path=Path(entry["path"]),
        digest=entry["digest"],
        definitions=entry["definitions"],
        imports=tuple(entry["imports"]),
        dynamic=tuple(entry["dynamic"]),
        resources=tuple(entry["resources"]),
    )


def _looks(looks: Mapping[str, Any]) -> dict[str, Look]:
    return {path: tuple(look) for path, look in looks.items()}
