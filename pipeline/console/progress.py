"""Showing a run: a live table on a terminal, plain lines elsewhere, or one JSON object per line for programs."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Protocol, Self, TextIO

from rich.console import Console

from pipeline.console.live_table import LiveTable
from pipeline.console.wording import Pace, ending, progress_words, remark_words
from pipeline.events import Event, Noted, Remarked, StageEnded, StageProgressed, StageStarted, as_json

NEAR = 5  # lines from the end, within which a failure is still in sight
SAY_EVERY = 10.0  # seconds between two plain lines about one stage


class Display(Protocol):
    """A context manager that is called with the events of a run, and shows them."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leaves the terminal as it was."""

    def __call__(self, event: Event) -> None: ...


def make_display(workflow: str, stages: int, *, json: bool) -> Display:
    """JSON lines on stdout, or else a live table or lines on stderr; `stages` is the number of stages."""
    if json:
        return JsonLines(sys.stdout)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    return LiveTable(console, workflow, stages) if console.is_terminal else PlainLines(sys.stderr)


class JsonLines:
    """One JSON object per line; causes of failures, remarks and notes go to stderr, for a person who reads along."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.flush()

    def __call__(self, event: Event) -> None:
        line = as_json(event)
        if line:
            print(line, file=self._stream, flush=True)
        words = _aside(event)
        if words:
            print(words, file=sys.stderr, flush=True)


def _aside(event: Event) -> str | None:
    """What a person has to know about an event that its JSON line does not say; None if there is nothing."""
    if isinstance(event, StageEnded) and event.state == "failed":
        return ending(event)
    if isinstance(event, Remarked):
        return remark_words(event)
    return event.text if isinstance(event, Noted) else None


class PlainLines:
    """A line when a stage starts and when it ends, and at most one every ten seconds in between; none if it is cached.

    Remarks that are not `as_wished`, and failures, are repeated at the end: after many stages, people read only the
    last lines. A single failure near the end is not repeated, since it is still in sight.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._paces: dict[str, Pace] = {}
        self._said: dict[str, float] = {}
        self._remarks: list[Remarked] = []
        self._failed: dict[str, StageEnded] = {}
        self._said_since = 0  # lines, since the last failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for event in self._remarks:
            self._say(remark_words(event))
        if len(self._failed) > 1 or self._said_since > NEAR:
            for failure in self._failed.values():
                self._say(ending(failure))
        self._stream.flush()

    def __call__(self, event: Event) -> None:
        moment = time.monotonic()
        if isinstance(event, StageStarted):
            self._said[event.name] = moment
            self._paces[event.name] = Pace()
            self._say(f"{event.name}: started")
        elif isinstance(event, StageProgressed) and event.name in self._paces:
            self._paces[event.name].note(moment, event.done)
            if moment - self._said[event.name] >= SAY_EVERY:
                self._said[event.name] = moment
                self._say(f"{event.name}: {progress_words(event, self._paces[event.name].left(event.total))}")
        elif isinstance(event, StageEnded):
            self._end(event)
        elif isinstance(event, Remarked):
            self._say(remark_words(event))
            if not event.as_wished:
                self._remarks.append(event)
        elif isinstance(event, Noted):
            self._say(event.text)

    def _end(self, event: StageEnded) -> None:
        self._failed.pop(event.name, None)
        if event.state != "cached":
            self._say(ending(event))
        if event.state == "failed":
            self._failed[event.name] = event
            self._said_since = 0

    def _say(self, text: str) -> None:
        self._said_since += 1
        print(text, file=self._stream, flush=True)
