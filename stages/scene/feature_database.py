"""COLMAP's database of pictures, features and matches, as far as the stage itself looks at it: is it whole?

COLMAP writes it without waiting for the disk, so that a power cut may leave anything, and a kill in bad luck, too.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

DATABASE, UNFINISHED = "database.db", "database.new"
"""The database has its name once all pictures are entered."""


def drop_damaged_database(folder: Path, pictures: int) -> str | None:
    """Remove what is not the whole database of so many pictures; returns what is wrong, None for a good one or none.

    To be called while nobody has it open. Left-overs of one that was not finished go without a word.
    """
    _remove(folder, UNFINISHED)
    path = folder / DATABASE
    damage = _damage(path, pictures) if path.exists() else None
    if damage is not None or not path.exists():  # a journal without its database would be taken for that of a new one
        _remove(folder, DATABASE)
    return damage


def _damage(path: Path, pictures: int) -> str | None:
    try:
        with closing(sqlite3.connect(path)) as database:
            ((found, *_), *_) = database.execute("PRAGMA quick_check").fetchall()
            if found != "ok":
                return str(found)
            ((entered,),) = database.execute("SELECT COUNT(*) FROM images").fetchall()
            return None if entered == pictures else f"{entered} of {pictures} pictures are in it"
    except sqlite3.Error as error:
        return str(error)


def _remove(folder: Path, name: str) -> None:
    for path in folder.glob(f"{name}*"):  # with -journal, -wal and -shm
        path.unlink()
