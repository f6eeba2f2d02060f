"""Whether a process works with the very code that its work was planned for.

Hours may pass between a plan and a stage, a worker may have loaded its modules days ago, and another machine may have
other sources. A result of other code than its key says would be stale for ever, so a stage fails instead. Editing the
sources while a training runs does no harm: a module counts as it was when it was loaded.
"""

from __future__ import annotations

import sys

from pipeline.errors import UserError
from pipeline.fingerprint import Code, SourceTree

MARK = "__fingerprint__"  # on a loaded module: the digest of its source when it was first seen here


class LoadedCode:
    """Watches the modules of `code`, of which some may be loaded later and some only by other processes."""

    def __init__(self, code: Code) -> None:
        self._code = code
        self._packages = {name.partition(".")[0] for name in code.modules}
        self._unseen = set(code.modules)

    def look(self) -> None:
        """Notes what has been loaded since the last look, be it of this code or not: a later stage may work with it."""
        for name, module in [*sys.modules.items()]:
            if name.partition(".")[0] in self._packages and not hasattr(module, MARK):
                setattr(module, MARK, self._as_loaded(name))
        self._unseen.difference_update(sys.modules)

    def _as_loaded(self, name: str) -> str | None:
        """The digest of a module that was loaded a moment ago; None, as no plan has it, if it is no Python now."""
        try:
            return self._on_disk([name])[name]
        except UserError:
            return None

    def check(self) -> None:
        """Raises UserError where a module was loaded, or could be loaded from now on, that is not as planned."""
        self.look()
        found = self._on_disk(self._unseen)
        found |= {name: getattr(sys.modules[name], MARK) for name in self._code.modules.keys() - self._unseen}
        other = sorted(name for name, digest in self._code.modules.items() if found[name] != digest)
        if other:
            raise UserError(
                "the code that is loaded here, or would be, is not the one that was planned",
                found=f"another {', '.join(other)}",
                remedy="It was edited since the run began, or the worker has other sources or loaded others long ago: "
                "give the workers the same version (PYTHONPATH), restart those that are not the run's, and run again.",
            )

    def _on_disk(self, names: list[str] | set[str]) -> dict[str, str | None]:
        if not names:
            return {}
        sources = SourceTree(self._packages)
        modules = {name: sources.module(name) for name in names}
        return {name: module.digest if module else None for name, module in modules.items()}
