"""Canonical JSON: equal values have equal hashes, and values that JSON would confuse with others are refused."""

from __future__ import annotations

import hashlib
import json
import math
from enum import Enum
from pathlib import Path
from typing import TypeAlias

Json: TypeAlias = bool | int | float | str | list["Json"] | dict[str, "Json"] | None
"""What a parameter, an attribute or a recorded fact may be."""


def plain(value: object, where: str) -> Json:
    """`value` as plain JSON data; enumerations become their values, tuples become lists.

    Raises TypeError for anything that JSON cannot distinguish from something else (bytes, sets, NumPy scalars, keys
    that are not strings), and ValueError for numbers that are not finite and text that is not Unicode. `where` names
    the value in the message.
    """
    if isinstance(value, Enum):
        return plain(value.value, where)
    if isinstance(value, str):
        return _checked(value, where)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{where} is {value}, which is not a finite number")
        return float(value)
    if isinstance(value, list | tuple):
        return [plain(item, f"{where}[{index}]") for index, item in enumerate(value)]
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{where} has the key {key!r}, which is not a string")
        return {_checked(key, where): plain(item, f"{where}.{key}") for key, item in value.items()}
    raise TypeError(
        f"{where} is of type {type(value).__name__}; expected text, numbers, true, false, null, lists or mappings"
    )


def _checked(text: str, where: str) -> str:
    """`text`, unless it holds surrogates: JSON spells a pair of them like the one character that it encodes.

    Raises ValueError then. Surrogates for undecodable bytes, as in names of files, are unambiguous and allowed.
    """
    if not text.isascii():
        try:
            text.encode("utf-8", "surrogateescape")
        except UnicodeEncodeError as error:
            raise ValueError(f"{where} is {text!r}, which is not Unicode text") from error
    return str(text)


def canonical_json(value: object, where: str = "value") -> bytes:
    """The canonical spelling of `value`: sorted keys, no whitespace, ASCII, shortest decimals that round-trip.

    Raises as `plain` does.

    >>> canonical_json({"b": 1.0, "a": (True, None)})
    b'{"a":[true,null],"b":1.0}'
    """
    return json.dumps(plain(value, where), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest_of(value: object, where: str = "value") -> str:
    """SHA-256 of the canonical JSON, in hexadecimal. Raises as `plain` does."""
    return hashlib.sha256(canonical_json(value, where)).hexdigest()


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
