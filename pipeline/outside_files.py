"""The digests of what the parameters of a workflow lead to outside the store, each file or folder read once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import Place, UserError
from pipeline.external import is_there
from pipeline.external_cache import ExternalCache
from pipeline.located import Problems

MakesCache = Callable[[], ExternalCache]
"""Called when all else is right: only then is anything read, or a place made to remember it in."""


@dataclass(frozen=True)
class Outside:
    """The paths that a parameter leads to, and where the workflow says so."""

    paths: tuple[str, ...]
    place: Place


class OutsideFiles:
    """Reads with `external`; what cannot be read joins `problems`."""

    def __init__(self, external: ExternalCache, problems: Problems) -> None:
        self._external = external
        self._problems = problems
        self._digests: dict[str, str] = {}

    def digests(self, parameters: Mapping[str, Outside]) -> dict[str, tuple[str, ...]]:
        """Of each parameter the digests of what it leads to; an empty one for a default that leads nowhere."""
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
