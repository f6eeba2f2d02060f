"""The log of one stage: what it reports, what the libraries under it print, and the traceback if it fails.

A line that cannot be written, for example on a full disk, is lost without an error: the stage's result is worth more.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path


class StageLog:
    """A new log at `path`, replacing any earlier one; nobody else can read a private one.

    Opening it raises OSError if it cannot be created.
    """

    def __init__(self, path: Path, private: bool) -> None:
        path.parent.parent.mkdir(parents=True, exist_ok=True)
        path.parent.mkdir(mode=0o700 if private else 0o777, exist_ok=True)
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600 if private else 0o644)
        self._file = os.fdopen(descriptor, "ab", buffering=0)

    def head(self, name: str, uses: str, key: str, commit: str | None) -> None:
        """Writes the first line, by which `is_log_of` recognises the log."""
        self.line(f"{name} ({uses}), key {key}, commit {commit or 'unknown'}")

    def line(self, text: str) -> None:
        """Writes one or more lines, with the time before the first."""
        self._write(f"{datetime.now():%H:%M:%S} {text}\n")

    def traceback(self) -> None:
        """Writes the exception that is being handled."""
        self._write(traceback.format_exc())

    def _write(self, text: str) -> None:
        with suppress(OSError):
            self._file.write(text.encode(errors="replace"))

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    @contextmanager
    def captured(self) -> Iterator[None]:
        """Redirects all that this process prints, C libraries included, to the log; for one stage at a time."""
        with _descriptors_to(self._file.fileno(), (1, 2)):
            yield


def is_log_of(key: str, path: Path) -> bool:
    """Whether a log is that of the action `key`; False if it is missing or cannot be read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a stranger's file may be a pipe
        with os.fdopen(descriptor, errors="replace") as file:
            return f", key {key}, " in file.readline()
    except OSError:
        return False


@contextmanager
def printed_to_stderr() -> Iterator[None]:
    """Redirects what this process prints to stderr: stdout is for the engine's own results."""
    with _descriptors_to(2, (1,)):
        yield


@contextmanager
def _descriptors_to(target: int, descriptors: tuple[int, ...]) -> Iterator[None]:
    _flush_printed()
    kept = [os.dup(descriptor) for descriptor in descriptors]
    for descriptor in descriptors:
        os.dup2(target, descriptor)
    try:
        yield
    finally:
        _flush_printed()
        for copy, descriptor in zip(kept, descriptors, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)


def _flush_printed() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # a full disk under the log, or a terminal that is gone
            if stream:
                stream.flush()
