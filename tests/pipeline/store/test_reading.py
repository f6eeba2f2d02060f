"""While gigabytes are read, a person sees how far that is: now and then in a log, in one line on a terminal."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from pipeline.store import reading
from pipeline.store.external_cache import ExternalCache
from pipeline.store.reading import CLEAR, PATIENCE, Reading
from pipeline.store.store import Store


class Clock:
    """A clock that only a test moves."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Gone(io.StringIO):
    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(reading, "time", clock)
    return clock


def read(folder: Path, stream: io.StringIO | None, clock: Clock, seconds: float) -> None:
    """Reads 30 files of 1000 bytes, each of which takes `seconds`."""
    folder.mkdir()
    files = [folder / f"{number}.jpg" for number in range(30)]
    for file in files:
        file.write_bytes(bytes(1000))
    watched = Reading(folder, stream)
    watched.listed(files)
    for _ in files:
        clock.now += seconds
        watched.one_done()
    watched.close()


def test_what_takes_long_is_said_every_ten_seconds(tmp_path: Path, clock: Clock) -> None:
    said = io.StringIO()
    read(tmp_path / "photos", said, clock, seconds=1.0)
    first, second, third = said.getvalue().splitlines()
    assert first == f"reading 2.0 kB of 30.0 kB, 2 of 30 files, to fingerprint {tmp_path}/photos"
    assert (second.split(",")[1], third.split(",")[1]) == (" 12 of 30 files", " 22 of 30 files")


def test_on_a_terminal_one_line_that_goes(tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    said = Terminal()
    read(tmp_path / "photos", said, clock, seconds=1.0)
    looks = said.getvalue().split(CLEAR)
    assert (looks[0], looks[1], looks[-1]) == ("", "reading 2.0 kB of 30.0 kB, 2 ", "")
    assert "\n" not in said.getvalue()


def test_what_is_soon_done_is_not_worth_a_word(tmp_path: Path, clock: Clock) -> None:
    said = Terminal()
    read(tmp_path / "photos", said, clock, seconds=PATIENCE / 31)
    assert said.getvalue() == ""


@pytest.mark.parametrize("stream", [Gone(), None])
def test_who_does_not_listen_holds_up_nothing(tmp_path: Path, clock: Clock, stream: io.StringIO | None) -> None:
    read(tmp_path / "photos", stream, clock, seconds=1.0)


def test_the_digests_of_a_folder_say_how_far_they_are(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").write_bytes(bytes(1000))
    said = io.StringIO()
    ExternalCache(Store(tmp_path / "store"), said).digest(tmp_path / "photos")
    assert said.getvalue() == f"reading 1.0 kB of 1.0 kB, 1 of 1 files, to fingerprint {tmp_path}/photos\n"
