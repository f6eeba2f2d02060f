"""`${…}` and `foreach`: what a workflow file says once and means several times."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from pipeline.errors import nearest
from pipeline.located import Located, Problems

Scope = Mapping[str, Located | None]
"""What `${name}` stands for; None for a name whose value is missing, which has been reported already."""

REFERENCE = re.compile(r"\$(\$|\{([^{}]*)\})")
LABEL = re.compile(r"[A-Za-z0-9_.,+-]{1,60}")


def substitute(located: Located, scope: Scope, problems: Problems) -> Located | None:
    """`located` with every `${name}` replaced; None, with the reason among `problems`, where that is impossible.

    A text that is nothing but `${name}` becomes the named value itself, with its type, its place and its base. `$$`
    stands for a dollar sign.
    """
    if isinstance(located.value, tuple):
        items = [substitute(item, scope, problems) for item in located.value]
        return None if None in items else replace(located, value=tuple(item for item in items if item is not None))
    if isinstance(located.value, Mapping):
        values = {name: substitute(item, scope, problems) for name, item in located.value.items()}
        if None in values.values():
            return None
        return replace(located, value={name: item for name, item in values.items() if item is not None})
    if not isinstance(located.value, str):
        return located
    whole = REFERENCE.fullmatch(located.value)
    if whole and whole[2] is not None:
        return _look_up(whole[2], located, scope, problems)
    return _interpolate(located, scope, problems)


def _interpolate(located: Located, scope: Scope, problems: Problems) -> Located | None:
    text, pieces, end = str(located.value), [], 0
    for match in REFERENCE.finditer(text):
        pieces.append(text[end : match.start()])
        end = match.end()
        if match[1] == "$":
            pieces.append("$")
            continue
        value = _look_up(match[2], located, scope, problems)
        if value is None:
            return None
        if isinstance(value.value, tuple | Mapping) or value.value is None:
            problems.add(located.place, f"${{{match[2]}}} is {value.found}, which cannot stand inside a text")
            return None
        pieces.append(str(value.value).lower() if isinstance(value.value, bool) else str(value.value))
    return replace(located, value="".join([*pieces, text[end:]]))


def _look_up(name: str, located: Located, scope: Scope, problems: Problems) -> Located | None:
    if name in scope:
        return scope[name]
    known = ", ".join(f"${{{known}}}" for known in scope) or "none"
    problems.add(located.place, f"${{{name}}} is not known; known are {known}{nearest(name, scope)}")
    return None


@dataclass(frozen=True)
class Item:
    """One pass of a `foreach`: a label that tells it from the others, and its values under `item.…`."""

    label: str
    scope: Mapping[str, Located]


def items(foreach: Located, problems: Problems) -> tuple[Item, ...] | None:
    """The passes of a `foreach`, a mapping of names to lists of one length that are walked together.

    None, with the reason among `problems`, where it is anything else.
    """
    lists = foreach.value
    if not isinstance(lists, Mapping) or not lists:
        problems.add(foreach.place, f"foreach is {foreach.found}; expected names with a list each: {{scene: [a, b]}}")
        return None
    columns: dict[str, tuple[Located, ...]] = {}
    for name, column in lists.items():
        if not isinstance(column.value, tuple) or not column.value:
            problems.add(column.place, f"foreach.{name} is {column.found}; expected a list with at least one item")
            return None
        columns[name] = column.value
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name}: {length}" for name, length in lengths.items())
        problems.add(foreach.place, f"the lists of a foreach are walked together; found lengths {found}")
        return None
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return tuple(
        Item(label, {f"item.{name}": value for name, value in row.items()})
        for label, row in zip(_labels(rows), rows, strict=True)
    )


def _labels(rows: list[dict[str, Located]]) -> list[str]:
    """A short name for each row from its own values, so that it keeps it when others come or go; else its number."""
    labels = [",".join(str(value.plain) for value in row.values()) for row in rows]
    if len(set(labels)) == len(labels) and all(LABEL.fullmatch(label) for label in labels):
        return labels
    return [str(number) for number in range(len(rows))]
