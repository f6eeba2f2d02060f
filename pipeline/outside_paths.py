"""Paths in a workflow that lead outside the store, made absolute, and those that lead nowhere."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

from pipeline.canonical import Json
from pipeline.errors import nearest_of
from pipeline.external import from_home, is_there, resolved
from pipeline.located import Located, Problems

MOST = 1000
"""Names of a folder among which one is sought that is like a missing one."""


def as_typed(value: Located) -> Located:
    """The value of an external path as it was typed: `2024`, `1e5` and `Holiday: Rome` are names.

    Null stays what it is. A list stays one, of such paths, unless what was typed is there, such as the folder `[fox]`.
    """
    literal = value if value.typed is None else replace(value, value=value.typed, typed=None)
    if isinstance(value.value, tuple) and (literal is value or not is_there(str(absolute(literal)))):
        return replace(value, value=tuple(map(as_typed, value.value)))
    return literal


def absolute(value: Located) -> Json:
    """The value of an external path, or a list of them, made absolute; anything else as it is, for others to refuse.

    A shell leaves the ~ in `--set cover=~/photos` as it stands, and so does whoever writes a workflow.
    """
    if isinstance(value.value, tuple):
        return [absolute(item) for item in value.value]
    if isinstance(value.value, str):
        return str(resolved(value.base / from_home(value.value)))
    return value.plain


def check_there(name: str, value: Located, problems: Problems) -> None:
    """Reports each path in the parameter `name` that is empty or leads nowhere.

    An empty path would be the folder of the workflow itself, which nobody means who leaves one out.
    """
    for path in value.items if isinstance(value.value, tuple) else (value,):
        if path.value == "":
            problems.add(path.place, f"parameter {name!r}: an empty path; expected that of a file or folder")
        elif isinstance(path.value, str) and not is_there(str(absolute(path))):
            missing = str(absolute(path))
            hint = _nearest_path(Path(missing))
            problems.add(path.place, f"parameter {name!r}: there is no file or folder {missing!r}{hint}")


def _nearest_path(missing: Path) -> str:
    """`; did you mean …?` with a path that is there and differs in one name; nothing where there is none."""
    wrong = next((path for path in reversed([missing, *missing.parents]) if not is_there(path)), missing)
    try:
        names = [path.name for path in islice(wrong.parent.iterdir(), MOST)]
    except (OSError, ValueError):
        return ""
    beside = {name: wrong.with_name(name) / missing.relative_to(wrong) for name in names}
    return nearest_of(wrong.name, {name: path for name, path in beside.items() if is_there(path)})
