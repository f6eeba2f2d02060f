"""The digests of the files and folders outside the store that a workflow's parameters lead to, each read once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import Place, UserError
from pipeline.store.external import is_there
from pipeline.store.external_cache import ExternalCache
from pipeline.workflow.located import Problems

MakesCache = Callable[[], ExternalCache]
"""Called once all else is right: until then, nothing is read, and no place is created to remember it in."""


@dataclass(frozen=True)
class Outside:
    """The paths that a parameter leads to, and the place in the workflow that says so."""

    paths: tuple[str, ...]
    place: Place


class OutsideFiles:
    """Digests files with `external`; what cannot be read is added to `problems`."""

    def __init__(self, external: ExternalCache, problems: Problems) -> None:
        self._external = external
        self._problems = problems
        self._digests: dict[str, str] = {}

    def digests(self, parameters: Mapping[str, Outside]) -> dict[str, tuple[str, ...]]:
        """The digests of what each parameter leads to; "" for a default that leads nowhere, and after a problem."""
        return {
            name: tuple(self._digest(path, name, outside.place) for path in outside.paths)
            for name, outside in parameters.items()
        }

    def _digest(self, path: str, name: str, place: Place) -> str:
        if path not in self._digests:
            if not is_there(path):
                return ""
            try:
                self._digests[path] = self._external.digest(Path(path))
            except UserError as error:
                self._problems.add(place, f"parameter {name!r}: {error}")
                return ""
        return self._digests[path]
