"""What a run prints where it can no longer be printed: it is lost, and the run goes on.

A terminal is closed below a run in the background, Ctrl-C ends the `tee` that reads a run before the run has saved its
checkpoints, the disk of a log is full: none of this is a reason to give up the work of hours, or to end with another
exit status than that of the work.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO, cast


class LossyStream:
    """A stream of text; what cannot be written to it is lost without an error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def open_closed_streams() -> None:
    """Has a stream that was closed before Python began (`2>&-`) lead nowhere: else the next file that is opened would
    be what is printed to, and every attempt to print fail.
    """
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere == descriptor:
                os.set_inheritable(nowhere, True)  # workers print, too
            else:  # the lowest that is free is another: this one was taken meanwhile
                os.close(nowhere)
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115  # for as long as the process


def spell_what_cannot_be_printed() -> None:
    """Has standard output spell what its encoding lacks, as standard error does: an arrow in Latin-1, or the name of a
    folder that is no UTF-8, is no reason to fail when all is done.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def lossy_output() -> Iterator[None]:
    """Has this process lose what it cannot print meanwhile, and what is then left of it when it exits."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, LossyStream(stream)) if stream else stream for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in before:
            if stream:
                _flush_or_drop(stream)


def _flush_or_drop(stream: TextIO) -> None:
    """Prints what is left; where nobody takes it, nowhere: Python's own attempt at exit would change the status."""
    try:
        stream.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
