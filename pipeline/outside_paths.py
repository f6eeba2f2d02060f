"""Paths in a workflow that lead outside the store, made absolute, and those that lead nowhere."""

from __future__ import annotations

from dataclasses import replace

from pipeline.canonical import Json
from pipeline.external import from_home, is_there, resolved
from pipeline.located import Located, Problems


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


def check_there(name: str, value: Located, problems: Problems) -> bool:
    """Reports each path in the parameter `name` that is empty or leads nowhere; returns whether all lead somewhere.

    An empty path would be the folder of the workflow itself, which nobody means who leaves one out.
    """
    before = len(problems)
    for path in value.items if isinstance(value.value, tuple) else (value,):
        if path.value == "":
            problems.add(path.place, f"parameter {name!r}: an empty path; expected that of a file or folder")
        elif isinstance(path.value, str) and not is_there(str(absolute(path))):
            problems.add(path.place, f"parameter {name!r}: there is no file or folder {absolute(path)!r}")
    return len(problems) == before
