"""Whether a process runs exactly the code that its work was planned for.

Hours may pass between a plan and a stage, a worker may have loaded its modules days ago, and another machine may have
other sources. A result of code other than its key says would be stale forever, so the stage fails instead. Editing the
sources while a training runs does no harm: a module counts as it was when it was loaded.
"""

from __future__ import annotations

import sys

from pipeline.code.fingerprint import Code, SourceTree
from pipeline.errors import UserError

MARK = "__fingerprint__"  # on a loaded module: the digest of its source when it was first seen here


class LoadedCode:
    """Watches the modules of `code`, some of which may be loaded later, or only by other processes."""

    def __init__(self, code: Code) -> None:
        self._code = code
        self._packages = {name.partition(".")[0] for name in code.modules}
        self._unseen = set(code.modules)

    def look(self) -> None:
        """Notes what has been loaded since the last look, part of this code or not: a later stage may use it."""
        for name, module in [*sys.modules.items()]:
            if name.partition(".")[0] in self._packages and not hasattr(module, MARK):
                setattr(module, MARK, self._as_loaded(name))
        self._unseen.difference_update(sys.modules)

    def _as_loaded(self, name: str) -> str | None:
        """The digest of a module that was just loaded; None, which no plan contains, if its file is not Python now."""
        try:
            return self._on_disk([name])[name]
        except UserError:
            return None

    def check(self) -> None:
        """Raises UserError if a module that is loaded, or could be loaded from now on, is not as planned."""
        self.look()
        found = self._on_disk(self._unseen)
        found |= {name: getattr(sys.modules[name], MARK) for name in self._code.modules.keys() - self._unseen}
        other = sorted(name for name, digest in self._code.modules.items() if found[name] != digest)
        if other:
            raise UserError(
                "the code that is loaded here, or would be, differs from what was planned",
                found=f"another version of {', '.join(other)}",
                remedy="It was edited since the run began, or the worker has other sources, or loaded them long ago: "
                "give the workers the same version (PYTHONPATH), restart those that are not the run's, and run again.",
            )

    def _on_disk(self, names: list[str] | set[str]) -> dict[str, str | None]:
        if not names:
            return {}
        sources = SourceTree(self._packages)
        modules = {name: sources.module(name) for name in names}
        return {name: module.digest if module else None for name, module in modules.items()}
