"""Pins: results that `gc` keeps whatever runs follow, under a name that the user chose.

    pins/<name>.json     the keys of all actions behind the pinned results, by stage

Names of stages may reveal a message, so nobody else can read these files.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pipeline.disk import flush, parse_json, read_plain_file
from pipeline.errors import CommandError, UserError, nearest

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.,\[\]-]{0,199}")


@dataclass(frozen=True)
class Pin:
    """The pinned results of a workflow: the key of each stage's action; `made` is when they were pinned."""

    workflow: str
    made: str
    keys: Mapping[str, str]


class Pins:
    """The pins of one store, in a folder that is created with the first pin."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def names(self) -> list[str]:
        """Names of all pins, sorted."""
        return sorted(path.stem for path in self._folder.glob("*.json"))

    def read(self, name: str) -> Pin:
        """The pin of that name. Raises UserError if it cannot be read: then nobody knows what it was meant to keep."""
        try:
            return _pin(parse_json(self._data(name)))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(
                "the pin cannot be read",
                where=self._place(name),
                found=error,
                remedy=f"Remove it with `unpin {name}`, and pin the results again.",
            ) from error

    def add(self, name: str, pin: Pin) -> None:
        """Adds a pin, atomically and durably. Raises CommandError if the name is taken or not allowed."""
        if not NAME.fullmatch(name):
            raise CommandError(f"{name!r} cannot name a pin", expected="letters, digits and '_' '-' '.' ',' '[' ']'")
        if not self._create(name, json.dumps(asdict(pin), indent=1, sort_keys=True).encode()):
            remedy = f"Choose another name with --name, or remove that pin with `unpin {name}`."
            raise CommandError(f"there is already a pin {name!r}", remedy=remedy)

    def remove(self, name: str) -> None:
        """Removes a pin. Raises CommandError if there is none of that name."""
        if name not in self.names:
            raise CommandError(
                f"no pin {name!r}; there are {', '.join(self.names) or 'none'}{nearest(name, self.names)}"
            )
        self._delete(name)

    def _place(self, name: str) -> str:
        return str(self._path(name))

    def _data(self, name: str) -> bytes:
        return read_plain_file(self._path(name))

    def _create(self, name: str, data: bytes) -> bool:
        """Writes a pin unless the name is taken, and returns whether it did."""
        if not self._folder.is_dir():
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            flush(self._folder.parent)
        aside = self._folder / f".{name}.{os.getpid()}"
        try:
            with os.fdopen(os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.link(aside, self._path(name))
        except FileExistsError:
            return False
        finally:
            aside.unlink(missing_ok=True)
        flush(self._folder)
        return True

    def _delete(self, name: str) -> None:
        self._path(name).unlink()

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.json"


def _pin(content: Any) -> Pin:
    """The pin in a file's content, which may be anyone's. Raises KeyError, TypeError or ValueError if it is none."""
    workflow, made, keys = content["workflow"], content["made"], content["keys"]
    if not isinstance(keys, dict) or not all(isinstance(text, str) for text in (workflow, made, *keys.values())):
        raise ValueError("something other than texts")
    return Pin(workflow, made, keys)
