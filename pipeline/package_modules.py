"""What modules a package has, by its folder alone: nothing is imported."""

from __future__ import annotations

from pathlib import Path


def modules_in(folder: Path) -> list[str]:
    """The names of the modules directly in a package's folder, sorted, but those that begin with `_`.

    Other files that end in `.py`, such as an editor's lock, are none. No folder has none.
    """
    found = (path for path in folder.glob("[!_]*.py") if path.stem.isidentifier() and path.is_file())
    return sorted(path.stem for path in found)
