"""Integrity check of COLMAP's database of pictures, features and matches.

COLMAP writes it without syncing to disk, so a power cut, or an unlucky kill, may leave it in any state.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

DATABASE, UNFINISHED = "database.db", "database.new"
"""The database gets its final name once all pictures are entered."""

PAIRS_IN_NEED = f"{DATABASE}.pairs_in_need"
"""An empty file beside the database once it may hold matches of pairs in need, without which the first estimate is
made."""


def drop_damaged_database(folder: Path, pictures: int) -> str | None:
    """Delete a database that is damaged or does not list `pictures` pictures, and return what is wrong with it.

    None if it is good or absent. Call this while no process has it open. Leftovers of an unfinished database are
    deleted silently.
    """
    _remove(folder, UNFINISHED)
    path = folder / DATABASE
    damage = _damage(path, pictures) if path.exists() else None
    if damage is not None or not path.exists():  # SQLite would apply a leftover journal to a new database
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
    for path in folder.glob(f"{name}*"):  # with -journal, -wal, -shm and .pairs_in_need
        path.unlink()
