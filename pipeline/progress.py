"""Showing a run: a live table on a terminal, plain lines elsewhere, or one JSON object a line for programs."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Protocol, Self, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from pipeline.events import Event, Noted, StageEnded, StageProgressed, StageStarted, State, Summary, as_json

SAY_EVERY = 10.0  # seconds between two plain lines about one stage


class Display(Protocol):
    """Shows the events of a run while it is entered."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leaves the terminal as it was."""

    def __call__(self, event: Event) -> None: ...


def make_display(workflow: str, stages: int, *, json: bool) -> Display:
    """The display that suits where the output goes."""
    if json:
        return JsonLines(sys.stdout)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    return LiveTable(console, workflow, stages) if console.is_terminal else PlainLines(sys.stderr)


class JsonLines:
    """One JSON object a line; why a stage failed goes to stderr."""

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
        if isinstance(event, StageEnded) and event.state == "failed":
            print(ending(event), file=sys.stderr, flush=True)


class PlainLines:
    """A line when a stage starts and ends, and at most one each ten seconds in between."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._first: dict[str, tuple[float, float]] = {}
        self._said: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.flush()

    def __call__(self, event: Event) -> None:
        moment = time.monotonic()
        if isinstance(event, StageStarted):
            self._said[event.name] = moment
            self._first.pop(event.name, None)
            self._say(f"{event.name}: started")
        elif isinstance(event, StageProgressed):
            since, done_before = self._first.setdefault(event.name, (moment, event.done))
            if moment - self._said.get(event.name, moment) >= SAY_EVERY:
                self._said[event.name] = moment
                self._say(f"{event.name}: {progress_words(event, moment - since, done_before)}")
        elif isinstance(event, StageEnded) and event.state != "cached":
            self._say(ending(event))
        elif isinstance(event, Noted):
            self._say(event.text)

    def _say(self, text: str) -> None:
        print(text, file=self._stream, flush=True)


class Remaining(ProgressColumn):
    """The time that a stage still takes, where it says how far it is."""

    def render(self, task: Task) -> Text:
        known = task.fields["figures"] is not None and task.time_remaining is not None
        return Text(f"{duration(task.time_remaining or 0.0)} left" if known else "", "cyan")


class Figures(ProgressColumn):
    """The current figures of a stage."""

    def render(self, task: Task) -> Text:
        return Text(figures_words(task.fields["figures"] or {}))


class LiveTable:
    """A row for each running stage with bar, remaining time and current figures; what has ended scrolls above."""

    def __init__(self, console: Console, workflow: str, stages: int) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=28),
            TextColumn("{task.fields[share]:>4}"),
            TimeElapsedColumn(),
            Remaining(),
            Figures(),
            console=console,
            refresh_per_second=5,
            transient=True,
        )
        self._all = self._progress.add_task(
            f"[bold]{escape(workflow)}", total=stages, share=f"0/{stages}", figures=None
        )
        self._stages = stages
        self._ended = 0
        self._rows: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageStarted):
            self._rows[event.name] = self._progress.add_task(escape(event.name), total=None, share="", figures={})
        elif isinstance(event, StageProgressed) and event.name in self._rows:
            share = f"{event.done / event.total:.0%}" if event.total else ""
            self._progress.update(
                self._rows[event.name],
                completed=event.done,
                total=event.total,
                share=share,
                figures=event.figures,
            )
        elif isinstance(event, StageEnded):
            self._end(event)
        elif isinstance(event, Noted):
            self._progress.console.print(Text(event.text, "yellow"))

    def _end(self, event: StageEnded) -> None:
        if event.name in self._rows:
            self._progress.remove_task(self._rows.pop(event.name))
        self._ended += 1
        self._progress.update(self._all, completed=self._ended, share=f"{self._ended}/{self._stages}")
        if event.state != "cached":
            style = {"ran": "green", "failed": "bold red", "skipped": "yellow"}[event.state]
            self._progress.console.print(Text(ending(event), style))


def ending(event: StageEnded) -> str:
    """How a stage ended, in one line.

    >>> ending(StageEnded("cover", "ran", "5e", 12.34, {}))
    'cover: done in 12.3 s'
    """
    if event.state == "ran":
        return f"{event.name}: done in {duration(event.seconds)}"
    if event.state == "cached":
        return f"{event.name}: cached"
    log = f" (log: {event.log})" if event.state == "failed" and event.log else ""
    return f"{event.name}: {event.state}: {event.cause}{log}"


def summary_words(workflow: str, summary: Summary) -> str:
    """The end of a run in one line.

    >>> summary_words("hide", Summary(4.2, {"ran": 3, "cached": 11}))
    'hide: 3 ran, 11 cached in 4.2 s'
    """
    states: tuple[State, ...] = ("ran", "cached", "failed", "skipped")
    counted = [f"{summary.counts[state]} {state}" for state in states if summary.counts.get(state)]
    return f"{workflow}: {', '.join(counted) or 'nothing to do'} in {duration(summary.seconds)}"


def progress_words(event: StageProgressed, elapsed: float, done_before: float = 0) -> str:
    """How far a stage is, in words; `done_before` is what an earlier run did, or what was done `elapsed` seconds ago.

    >>> progress_words(StageProgressed("hide", 300, 1200, {"psnr": 22.125}), 60.0)
    '25 % (300 of 1200), 3 min left, psnr 22.12'
    >>> progress_words(StageProgressed("hide", 900, 1200, {}), 60.0, done_before=600)
    '75 % (900 of 1200), 1 min left'
    """
    parts = [f"{event.done:g} of {event.total:g}"]
    if event.total:
        parts = [f"{100 * event.done / event.total:.0f} % ({event.done:g} of {event.total:g})"]
    done = event.done - done_before
    if done > 0 and event.total:
        parts.append(f"{duration(elapsed * (event.total - event.done) / done)} left")
    return ", ".join([*parts, *([figures_words(event.figures)] if event.figures else [])])


def figures_words(figures: Mapping[str, float]) -> str:
    """
    >>> figures_words({"psnr": 22.1234, "splats": 31000})
    'psnr 22.12, splats 31,000'
    """
    return ", ".join(f"{name} {value:{'.4g' if abs(value) < 1000 else ',.0f'}}" for name, value in figures.items())


def duration(seconds: float) -> str:
    """
    >>> duration(0.04), duration(75), duration(180), duration(4000)
    ('0.0 s', '1 min 15 s', '3 min', '1 h 6 min')
    """
    if seconds < 60:
        return f"{seconds:.1f} s"
    large, small, names = (*divmod(round(seconds), 60), ("min", "s"))
    if large >= 60:
        large, small, names = (*divmod(large, 60), ("h", "min"))
    return f"{large} {names[0]}" + (f" {small} {names[1]}" if small else "")
