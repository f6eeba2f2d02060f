"""Whatever a kill or a power cut leaves of COLMAP's database is used again whole or not at all."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from stages.scene.feature_database import drop_damaged_database

PICTURES = 3


def write_database(folder: Path) -> Path:
    """A database of `PICTURES` pictures whose features take several pages."""
    path = folder / "database.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT)")
        database.execute("CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, data BLOB)")
        database.executemany("INSERT INTO images (name) VALUES (?)", [(f"{row}.png",) for row in range(PICTURES)])
        database.executemany("INSERT INTO keypoints (data) VALUES (?)", [(b"\1" * 9000,)] * PICTURES)
    return path


def shorten(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


def overwrite(path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[:4096] + bytes(4096) + whole[8192:])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def fill_with_noise(path: Path) -> None:
    path.write_bytes(b"\7" * 20_000)


def test_a_whole_database_is_kept_as_it_is(tmp_path: Path) -> None:
    whole = write_database(tmp_path).read_bytes()
    assert drop_damaged_database(tmp_path, PICTURES) is None
    assert (tmp_path / "database.db").read_bytes() == whole


@pytest.mark.parametrize("damage", [shorten, overwrite, empty, fill_with_noise])
def test_a_damaged_one_is_removed_with_all_that_belongs_to_it(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    damage(write_database(tmp_path))
    for name in ("database.db-wal", "database.db-shm", "database.new", "database.new-wal"):
        (tmp_path / name).write_bytes(b"left over")
    (tmp_path / "000000.png").write_bytes(b"a working picture")
    assert drop_damaged_database(tmp_path, PICTURES)
    assert [path.name for path in tmp_path.iterdir()] == ["000000.png"]


def test_the_database_of_other_pictures_is_none_of_these(tmp_path: Path) -> None:
    write_database(tmp_path)
    assert drop_damaged_database(tmp_path, PICTURES + 1) == "3 of 4 pictures are in it"


def test_a_journal_without_its_database_is_removed_and_is_no_damage(tmp_path: Path) -> None:
    (tmp_path / "database.db-wal").write_bytes(b"left over")
    assert drop_damaged_database(tmp_path, PICTURES) is None
    assert not list(tmp_path.iterdir())
