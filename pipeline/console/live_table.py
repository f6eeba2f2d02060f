"""A run on a terminal: what is running, how far and how good it is so far; what failed, and counts of everything else.

The table has a row for each running stage, however many stages there are. Ended stages scroll away above it, or are
only counted if there are many. Failures stay in sight; they and remarks on results are repeated when the table closes.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from pipeline.console.wording import Pace, clock_words, ending, figures_words, remark_words
from pipeline.events import Event, Noted, Remarked, StageEnded, StageProgressed, StageStarted, StageState

MANY = 100  # stages; if there are more, those that ended well are only counted
SHOWN_FAILURES = 5
LAST_ENDED = 3
OTHER_LINES = SHOWN_FAILURES + 5  # besides those of running stages
REFRESHES = 5  # a second
STYLES: Mapping[StageState, str] = {"ran": "green", "failed": "bold red", "skipped": "yellow", "cached": "dim"}
REMARK = "bold yellow"
WIDE, NARROW = 100, 60  # columns of the terminal: from `WIDE` on everything is shown, below `NARROW` no bars


@dataclass
class Running:
    """A running stage."""

    started: float
    done: float = 0.0
    total: float = 0.0
    figures: Mapping[str, float] = field(default_factory=dict)
    pace: Pace = field(default_factory=Pace)


class LiveTable:
    """Shows a run of `stages` stages on a terminal; to be used as a context manager around it."""

    def __init__(self, console: Console, workflow: str, stages: int) -> None:
        self._console = console
        self._workflow = workflow
        self._stages = stages
        self._began = time.monotonic()
        self._running: dict[str, Running] = {}
        self._ended: dict[str, StageState] = {}
        self._failed: dict[str, StageEnded] = {}
        self._remarks: list[Remarked] = []
        self._last: deque[str] = deque(maxlen=LAST_ENDED)
        self._changing = threading.RLock()  # the table is drawn by a thread of its own
        self._taking = False
        self._unsaid: deque[Text] = deque()
        self._live = Live(
            console=console, get_renderable=self.table, refresh_per_second=REFRESHES, transient=True, screen=False
        )

    def __enter__(self) -> Self:
        self._live.start(refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()
        for remark in self._remarks:
            self._console.print(Text(remark_words(remark), REMARK))
        for event in self._failed.values():
            self._console.print(Text(ending(event), STYLES["failed"]))

    def __call__(self, event: Event) -> None:
        """Shows an event. If a signal handler reports another one meanwhile, that one is shown afterwards.

        The thread that draws the table may be waiting for our lock, so nothing is printed while we hold it.
        """
        amid, self._taking = self._taking, True
        try:
            with self._changing:
                above = self._take(event)
                self._unsaid += [above] if above else []
        finally:
            self._taking = amid
        while self._unsaid and not amid:
            self._console.print(self._unsaid.popleft())

    def _take(self, event: Event) -> Text | None:
        """Takes note of an event; returns what to print about it above the table, if anything."""
        if isinstance(event, StageStarted):
            self._running[event.name] = Running(time.monotonic())
        elif isinstance(event, StageProgressed) and event.name in self._running:
            row = self._running[event.name]
            row.done, row.total, row.figures = event.done, event.total, event.figures
            row.pace.note(time.monotonic(), event.done)
        elif isinstance(event, StageEnded):
            return self._end(event)
        elif isinstance(event, Remarked):
            if event.as_wished:
                return Text(remark_words(event), STYLES["ran"])
            self._remarks.append(event)
            return Text(remark_words(event), REMARK)
        elif isinstance(event, Noted):
            return Text(event.text, "yellow")
        return None

    def _end(self, event: StageEnded) -> Text | None:
        self._running.pop(event.name, None)
        self._ended[event.name] = event.state
        self._failed.pop(event.name, None)
        if event.state == "failed":
            self._failed[event.name] = event
            return None
        if event.state == "cached":
            return None
        self._last.append(event.name)
        return Text(ending(event), STYLES[event.state]) if self._stages <= MANY else None

    def table(self) -> RenderableType:
        """The table as it is now, fitted to the terminal."""
        with self._changing:
            room = max(1, self._console.height - OTHER_LINES)
            lines: list[RenderableType] = [self._whole()]
            shown = dict(list(self._running.items())[:room])
            if shown:
                lines.append(self._rows(shown))
            if len(self._running) > room:
                lines.append(Text(f"  and {len(self._running) - room} more are running", "dim"))
            if self._stages > MANY and self._last:
                lines.append(_line(f"  last done: {', '.join(reversed(self._last))}", "dim"))
            failures = list(self._failed.values())
            lines += [_line(ending(event), STYLES["failed"]) for event in failures[-SHOWN_FAILURES:]]
            if len(failures) > SHOWN_FAILURES:
                lines.append(_line(f"and {len(failures) - SHOWN_FAILURES} more failed", STYLES["failed"]))
        return Group(*lines)

    def _whole(self) -> RenderableType:
        counts = [f"{len(self._running)} running"] if self._running else []
        states = list(self._ended.values())
        counts += [f"{states.count(state)} {state}" for state in STYLES if state in states]
        elapsed = clock_words(time.monotonic() - self._began)
        words = f"{len(self._ended)} of {self._stages} stages: {', '.join(counts) or 'starting'}, {elapsed}"
        return _line(f"{self._workflow}  {words}", "bold")

    def _rows(self, shown: Mapping[str, Running]) -> Table:
        width = self._console.width
        table = Table.grid(padding=(0, 1))
        table.add_column(no_wrap=True, overflow="ellipsis", max_width=width // 4 if width >= NARROW else width // 2)
        if width >= NARROW:
            table.add_column(width=width // 5)
        table.add_column(justify="right", no_wrap=True, min_width=5)
        if width >= WIDE:
            table.add_column(justify="right", no_wrap=True)
        if width >= NARROW:
            table.add_column(justify="right", no_wrap=True, style="cyan")
        table.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
        for name, row in shown.items():
            table.add_row(*self._cells(name, row, width))
        return table

    def _cells(self, name: str, row: Running, width: int) -> list[RenderableType]:
        left = row.pace.left(row.total)
        cells: list[RenderableType] = [Text(f"  {name}")]
        if width >= NARROW:
            cells.append(ProgressBar(row.total or 1.0, min(row.done, row.total)) if row.total else Text())
        cells.append(Text(f"{row.done / row.total:.0%}" if row.total else ""))
        if width >= WIDE:
            cells.append(Text(clock_words(time.monotonic() - row.started)))
        if width >= NARROW:
            cells.append(Text(f"{clock_words(left)} left" if left is not None else ""))
        return [*cells, Text(figures_words(row.figures))]


def _line(text: str, style: str) -> Text:
    """Text that is cut at the edge of the terminal."""
    return Text(text, style, no_wrap=True, overflow="ellipsis")
