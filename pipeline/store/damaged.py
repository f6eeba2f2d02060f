"""The damaged data of a store, kept apart since nobody knows yet whether it can be made again.

    damaged/objects/<digest>         artifacts
    damaged/actions/<key>            records
    damaged/foreign/<digest>/…       files that something else put into an artifact

If a name is taken, a number is appended. Nobody else can enter the folder, and only `gc` deletes from it.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path, PurePosixPath

from pipeline.disk import close_to_others, leads_elsewhere
from pipeline.errors import UserError
from pipeline.store.record import RECORD, Record, read_record

OBJECTS, ACTIONS, FOREIGN = "objects", "actions", "foreign"


class Damaged:
    """The damaged data of one store, in a folder that is created when it is first needed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def take(self, path: Path, *names: str) -> Path | None:
        """Moves `path` into the folder, under `names`, and returns its new path; None if it is already gone.

        Raises UserError if a folder on the way is a link.
        """
        wanted = self.folder.joinpath(*names)
        if leads_elsewhere(self.folder.parent, self.folder.name, *names[:-1]):
            raise UserError("a link; expected a folder", where=wanted.parent, remedy="Remove it, and try again.")
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        close_to_others(self.folder)
        wanted.parent.mkdir(parents=True, exist_ok=True)
        try:
            target = next(free for free in _numbered(wanted) if not os.path.lexists(free))
            path.rename(target)
        except FileNotFoundError:
            return None
        return target

    def records(self, key: str) -> list[Path]:
        """The paths of the damaged records of an action."""
        return sorted(self.folder.glob(f"{ACTIONS}/{key}*"))

    def record(self, name: str) -> Record | None:
        """A record that is sound itself and was set aside because its artifacts are not; None if it cannot be read.

        `name` is one of the store's `entries`.
        """
        return read_record(self.folder / ACTIONS / PurePosixPath(name).name / RECORD, name_in_damaged(name))


def name_in_damaged(name: str) -> str:
    """The digest or key of something damaged: its name without the folder and a number or `.json` at the end.

    >>> name_in_damaged("damaged/objects/abc.2"), name_in_damaged("damaged/actions/abc.json"), name_in_damaged("abc")
    ('abc', 'abc', 'abc')
    """
    return name.rpartition("/")[2].partition(".")[0]


def _numbered(path: Path) -> itertools.chain[Path]:
    return itertools.chain([path], (path.with_name(f"{path.name}.{number}") for number in itertools.count(2)))
