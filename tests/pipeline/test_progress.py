"""What a person sees of a run."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from pipeline import progress
from pipeline.events import Event, Noted, StageEnded, StageProgressed, StageStarted
from pipeline.progress import LiveTable, PlainLines

EVENTS: list[Event] = [
    StageStarted("hide"),
    StageProgressed("hide", 200, 1200, {"psnr": 20.0}),  # it went on from a checkpoint
    StageProgressed("hide", 300, 1200, {"psnr": 22.125}),
    Noted("a note"),
    StageEnded("cover", "cached", "5e", 0.0, {}),
    StageEnded("hide", "ran", "5e", 61.0, {}),
    StageEnded("bad", "failed", "5e", 1.0, {}, "no pictures", Path("bad.log")),
]


def clock(step: float) -> Callable[[], float]:
    times = iter(range(1000))
    return lambda: step * next(times)


@pytest.mark.parametrize(("step", "said"), [(1.0, False), (12.0, True)])
def test_plain_lines(monkeypatch: pytest.MonkeyPatch, step: float, said: bool) -> None:
    """At most one line each ten seconds between the first and the last; what is left follows from this run's pace."""
    monkeypatch.setattr(progress.time, "monotonic", clock(step))
    stream = io.StringIO()
    with PlainLines(stream) as display:
        for event in EVENTS:
            display(event)
    first = "hide: 17 % (200 of 1200), psnr 20"
    middle = [first, "hide: 25 % (300 of 1200), 1 min 48 s left, psnr 22.12"] if said else []
    assert stream.getvalue().splitlines() == [
        "hide: started",
        *middle,
        "a note",
        "hide: done in 1 min 1 s",
        "bad: failed: no pictures (log: bad.log)",
    ]


def test_live_table() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120, highlight=False, soft_wrap=True)
    with LiveTable(console, "hide_multi", 3) as display:
        for event in EVENTS[:3]:
            display(event)
        display._progress.refresh()
        shown = stream.getvalue()
        for event in EVENTS[3:]:
            display(event)
    assert " 25%" in shown
    assert "psnr 22.12" in shown
    assert "0/3" in shown
    assert "hide: done in 1 min 1 s" in stream.getvalue()
    assert "bad: failed: no pictures (log: bad.log)" in stream.getvalue()
