"""Output that can no longer be printed is dropped, and the run goes on. Other commands say so, and end.

The terminal of a background run is closed, Ctrl-C ends the `tee` that reads a run's output before the run has saved its
checkpoints, the disk of a log is full: none of this is a reason to give up hours of work, or to end with an exit status
other than that of the work.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO, cast

from pipeline.errors import PipelineError


class _Stream:
    """A text stream around another."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class LossyStream(_Stream):
    """A text stream that drops what cannot be written, without an error."""

    def write(self, text: str) -> int:
        """Writes `text` if possible, and returns its length in any case."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flushes the stream if possible."""
        with suppress(OSError):
            self._stream.flush()


class NamedOutput(_Stream):
    """Standard output whose errors say so: the system's do not, and would pass for those of the store's disk."""

    def write(self, text: str) -> int:
        """Writes `text` and returns its length. Raises PipelineError if it cannot, BrokenPipeError without a reader."""
        with _named(self._stream):
            return self._stream.write(text)

    def flush(self) -> None:
        """Flushes the stream. Raises the same errors as `write`."""
        with _named(self._stream):
            self._stream.flush()


@contextmanager
def _named(stream: TextIO) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        write_no_more(stream)
        raise PipelineError(f"standard output cannot be written: {error.strerror}") from error


def open_closed_streams() -> None:
    """Points standard streams that were closed before Python started (`2>&-`) to `/dev/null`.

    Otherwise the next file to be opened would receive what is printed, and every attempt to print would fail.
    """
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere == descriptor:
                os.set_inheritable(nowhere, True)  # workers print, too
            else:  # another was the lowest free one: this one was taken meanwhile
                os.close(nowhere)
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115  # open until the process ends


def spell_what_cannot_be_printed() -> None:
    """Makes standard output escape what its encoding lacks, as standard error does.

    An arrow in Latin-1, or the name of a folder that is not UTF-8, is no reason to fail when all the work is done.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def named_output() -> Iterator[None]:
    """Within the block, raises PipelineError if standard output cannot be written, and then writes no more to it."""
    before = sys.stdout
    sys.stdout = cast(TextIO, NamedOutput(before))
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout = before


def write_no_more(stream: TextIO) -> None:
    """Discards what is left in a stream, and all that is written to it from now on."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


@contextmanager
def lossy_output() -> Iterator[None]:
    """Within the block, drops what this process cannot print; at its end, drops what cannot be flushed either."""
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
    """Flushes a stream, or drops what is left: Python's own attempt to flush it at exit would change the status."""
    try:
        stream.flush()
    except OSError:
        write_no_more(stream)
