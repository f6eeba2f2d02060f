"""Paths in a workflow that lead outside the store: made absolute, and reported if they lead nowhere."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

from pipeline.canonical import Json
from pipeline.errors import nearest_of
from pipeline.store.external import from_home, is_there, resolved
from pipeline.workflow.located import Located, Problems

MOST = 1000
"""How many names in a folder are searched for one that resembles a missing one."""


def as_typed(value: Located) -> Located:
    """The value of an external path as it was typed: `2024`, `1e5` and `Holiday: Rome` are names.

    Null stays null. A list stays a list, of paths as they were typed, unless its own text is a path that exists, for
    example the folder `[fox]`.
    """
    literal = value if value.typed is None else replace(value, value=value.typed, typed=None)
    if isinstance(value.value, tuple) and (literal is value or not is_there(str(absolute(literal)))):
        return replace(value, value=tuple(map(as_typed, value.value)))
    return literal


def absolute(value: Located) -> Json:
    """An external path, or a list of them, made absolute; anything else unchanged, for others to refuse.

    A leading ~ is expanded: not every shell does that in `--set cover=~/photos`, and none does it in a workflow file.
    """
    if isinstance(value.value, tuple):
        return [absolute(item) for item in value.value]
    if isinstance(value.value, str):
        return str(resolved(value.base / from_home(value.value)))
    return value.plain


def check_there(name: str, value: Located, problems: Problems) -> None:
    """Reports each path in the parameter `name` that is empty or leads nowhere.

    An empty path would mean the folder of the workflow itself, which is never intended.
    """
    for path in value.items if isinstance(value.value, tuple) else (value,):
        if path.value == "":
            problems.add(path.place, f"parameter {name!r}: an empty path; expected the path of a file or folder")
        elif isinstance(path.value, str) and not is_there(str(absolute(path))):
            missing = str(absolute(path))
            hint = _nearest_path(Path(missing))
            given = sorted({str(source) for source in path.sources if source.file.startswith("--set ")})
            origin = f" (from {' and '.join(given)})" if given and str(path.place) not in given else ""
            problems.add(path.place, f"parameter {name!r}: there is no file or folder {missing!r}{origin}{hint}")


def _nearest_path(missing: Path) -> str:
    """`; did you mean …?` with an existing path that differs in one name; empty if there is none."""
    wrong = next((path for path in reversed([missing, *missing.parents]) if not is_there(path)), missing)
    try:
        names = [path.name for path in islice(wrong.parent.iterdir(), MOST)]
    except (OSError, ValueError):
        return ""
    beside = {name: wrong.with_name(name) / missing.relative_to(wrong) for name in names}
    return nearest_of(wrong.name, {name: path for name, path in beside.items() if is_there(path)})
