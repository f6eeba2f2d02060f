"""The modules of a package, read from its folders: the package itself is not imported."""

from __future__ import annotations

import importlib.util
from pathlib import Path


def folders_of(package: str) -> tuple[Path, ...]:
    """Where a package lies; empty if there is none of that name.

    Raises ModuleNotFoundError if a package above it does not exist: those are imported.
    """
    try:
        specification = importlib.util.find_spec(package)
    except ValueError:  # a module put into sys.modules by hand
        return ()
    found = specification.submodule_search_locations if specification else None
    return tuple(map(Path, found or ()))


def modules_in(folder: Path) -> list[str]:
    """The names of the modules directly in a package's folder, sorted, except those that begin with `_`.

    Other files that end in `.py`, such as an editor's lock file, do not count. Empty if there is no such folder.
    """
    found = (path for path in folder.glob("[!_]*.py") if path.stem.isidentifier() and path.is_file())
    return sorted(path.stem for path in found)
