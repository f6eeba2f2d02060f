"""What items state besides the columns that tables know, and which of these values distinguish measurements."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

PossibleSettings = Mapping[str, float | str]
"""Values that may be settings, by name."""


def others(values: Mapping[str, object], known: Collection[str]) -> dict[str, object]:
    """What an item states besides the `known` columns.

    Entries of a mapping, such as the settings of a method of your own, have names such as `own.levels`.
    """
    found: dict[str, object] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= {f"{name}.{key}": each for key, each in value.items()}
        elif name not in known:
            found[name] = value
    return found


def possible_settings(stated: Mapping[str, object]) -> dict[str, float | str]:
    """Those of `others` that may be settings: numbers, and all entries of mappings, except for seeds.

    >>> possible_settings({"levels": 2, "message": "reef", "clean_seed": 3, "own.mode": "fast"})
    {'levels': 2.0, 'own.mode': 'fast'}
    """
    texts = {name: str(value) for name, value in stated.items() if not name.endswith("seed")}
    numbers = {name: float(text) for name, text in texts.items() if re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", text)}
    return {name: numbers.get(name, text) for name, text in texts.items() if name in numbers or "." in name}


def telling(alike: Iterable[tuple[str, object, PossibleSettings]]) -> dict[str, set[str]]:
    """For each method, the names of the values in which measurements of the same key differ.

    Tables would average over these measurements otherwise. Such a value may be a setting of a method of your own.
    """
    groups: dict[tuple[str, object], list[PossibleSettings]] = {}
    for method, key, own in alike:
        groups.setdefault((method, key), []).append(own)
    found: dict[str, set[str]] = {method: set() for method, _ in groups}
    for (method, _), group in groups.items():
        found[method] |= {name for name in set().union(*group) if len({own.get(name) for own in group}) > 1}
    return found
