"""The progress of reading external files, for a person who waits: many gigabytes take minutes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from pipeline.disk import size_at, size_words
from pipeline.plain_text import in_a_line

PATIENCE = 2.0  # seconds of silence at the beginning
SAY_EVERY = 10.0  # seconds between two lines
SHOW_EVERY = 0.5  # seconds between two updates on a terminal, where each replaces the one before
CLEAR = "\r\x1b[K"  # erases the line on a terminal


class Reading:
    """Counts the files of `path` as they are read, and after two seconds reports on `stream`, if there is one.

    Errors of the stream are ignored: they are no reason to stop reading.
    """

    def __init__(self, path: Path, stream: TextIO | None) -> None:
        self._path = path
        self._stream = stream
        self._live = stream is not None and stream.isatty()
        self._files: Sequence[Path] = ()
        self._sizes: list[int] = []
        self._done = 0
        self._next = time.monotonic() + PATIENCE
        self._told = False

    def listed(self, files: Sequence[Path]) -> None:
        """Says which files are going to be read, in order."""
        self._files = files

    def one_done(self) -> None:
        """Counts the next file, which was read or already known."""
        self._done += 1
        if self._stream is not None and time.monotonic() >= self._next:
            self._next = time.monotonic() + (SHOW_EVERY if self._live else SAY_EVERY)
            self._say()

    def close(self) -> None:
        """Erases the last report on a terminal."""
        if self._told and self._live:
            self._write(CLEAR)

    def _say(self) -> None:
        self._told = True
        self._sizes = self._sizes or [size_at(file) for file in self._files]
        read, total = sum(self._sizes[: self._done]), sum(self._sizes)
        counted = f"{self._done:,} of {len(self._files):,} files"
        text = (
            f"reading {size_words(read)} of {size_words(total)}, {counted}, to fingerprint {in_a_line(str(self._path))}"
        )
        if self._live:
            self._write(CLEAR + text[: shutil.get_terminal_size().columns - 1])
        else:
            self._write(f"{text}\n")

    def _write(self, text: str) -> None:
        with suppress(OSError):
            print(text, file=self._stream, end="", flush=True)
