"""The code that this process runs, compared with the code that an action's key stands for.

A worker may be on another machine, with another copy of the sources; or it may have imported a module that was edited
since; or the sources are edited while a run goes on. Each would put a result into the store under a key that speaks of
other code, where it is taken for sound ever after. So a worker compares before it works.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType

from pipeline.canonical import digest_of, digest_of_file
from pipeline.errors import UserError
from pipeline.fingerprint import SourceTree

NAMED = 3  # modules that an error names


class LoadedCode:
    """What the first-party modules that this process has imported were when it imported them."""

    def __init__(self) -> None:
        self._digests: dict[str, tuple[ModuleType, str]] = {}

    def check(self, modules: Mapping[str, str]) -> None:
        """Raises UserError where one of the `modules`, given with their digests, is or would be another one here."""
        sources = SourceTree({name.partition(".")[0] for name in modules})
        stale, other = [], []
        for name, digest in modules.items():
            loaded = self._loaded(name)
            if loaded is None:
                module = sources.module(name)
                if module is None or module.digest != digest:
                    other.append(name)
            elif loaded != digest:
                stale.append(name)
        if stale:
            raise UserError(
                f"the worker has loaded an older or newer version of {_named(stale)}",
                remedy="Restart the workers, and run again.",
            )
        if other:
            raise UserError(
                f"the worker's sources are not those of the run: {_named(other)}",
                expected="the same on both",
                remedy="Give the workers the same version (PYTHONPATH); if it was edited meanwhile, run again.",
            )

    def remember(self, modules: Mapping[str, str]) -> None:
        """Keeps the digests, which were checked before, of those of the `modules` that are imported by now."""
        for name, digest in modules.items():
            if name in sys.modules and self._loaded(name) is None:
                self._digests[name] = sys.modules[name], digest

    def _loaded(self, name: str) -> str | None:
        module, digest = self._digests.get(name, (None, None))
        return digest if module is not None and sys.modules.get(name) is module else None


@functools.cache
def loaded_code() -> LoadedCode:
    """The one of this process."""
    return LoadedCode()


@functools.cache
def engine_digest() -> str:
    """SHA-256 over the engine's own sources, as they were when this process asked first."""
    folder = Path(__file__).parent
    return digest_of({file.name: digest_of_file(file) for file in sorted(folder.glob("*.py"))}, "the engine")


def check_engine(digest: str) -> None:
    """Raises UserError where the engine of this process is not the one with that digest."""
    if digest != engine_digest():
        raise UserError(
            "the worker has another version of the engine than the run",
            where=Path(__file__).parent,
            expected="the same sources",
            remedy="Give the workers the same version (PYTHONPATH), and restart them.",
        )


def _named(modules: Iterable[str]) -> str:
    names = sorted(modules)
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
