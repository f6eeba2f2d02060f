"""The modules of a package, read from its folder: nothing is imported."""

from __future__ import annotations

from pathlib import Path


def modules_in(folder: Path) -> list[str]:
    """The names of the modules directly in a package's folder, sorted, except those that begin with `_`.

    Other files that end in `.py`, such as an editor's lock file, do not count. Empty if there is no such folder.
    """
    found = (path for path in folder.glob("[!_]*.py") if path.stem.isidentifier() and path.is_file())
    return sorted(path.stem for path in found)
