"""The log of one stage: what it says, what the libraries under it print, and the traceback if it fails."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path


class StageLog:
    """Starts the log at `path` anew; nobody else can read a private one."""

    def __init__(self, path: Path, private: bool) -> None:
        path.parent.parent.mkdir(parents=True, exist_ok=True)
        path.parent.mkdir(mode=0o700 if private else 0o777, exist_ok=True)
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600 if private else 0o644)
        self._file = os.fdopen(descriptor, "a", encoding="utf-8", buffering=1)

    def line(self, text: str) -> None:
        """Writes a line, or several, with the time before the first."""
        self._file.write(f"{datetime.now():%H:%M:%S} {text}\n")

    def traceback(self) -> None:
        """Writes the exception that is being handled."""
        self._file.write(traceback.format_exc())

    def close(self) -> None:
        self._file.close()

    @contextmanager
    def captured(self) -> Iterator[None]:
        """Sends all that this process prints, C libraries included, here; for a process with one stage at a time."""
        with _descriptors_to(self._file.fileno(), (1, 2)):
            yield


@contextmanager
def printed_to_stderr() -> Iterator[None]:
    """Sends what this process prints to stderr: stdout is for the engine's own results."""
    with _descriptors_to(2, (1,)):
        yield


@contextmanager
def _descriptors_to(target: int, descriptors: tuple[int, ...]) -> Iterator[None]:
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(descriptor) for descriptor in descriptors]
    for descriptor in descriptors:
        os.dup2(target, descriptor)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for copy, descriptor in zip(kept, descriptors, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
