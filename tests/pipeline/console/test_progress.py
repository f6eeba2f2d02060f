"""What a person sees of a run."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.console import progress
from pipeline.console.progress import JsonLines, PlainLines
from pipeline.events import Event, Noted, Remarked, StageEnded, StageProgressed, StageStarted

EVENTS: list[Event] = [
    StageStarted("hide"),
    StageProgressed("hide", 240, 1200, {"psnr": 21.5}),
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
    """Between the start and the end of a stage, at most one line every ten seconds."""
    monkeypatch.setattr(progress.time, "monotonic", clock(step))
    stream = io.StringIO()
    with PlainLines(stream) as display:
        for event in EVENTS:
            display(event)
    first, second = "hide: 20 % (240 of 1200), psnr 21.5", "hide: 25 % (300 of 1200), 3 min left, psnr 22.12"
    middle = [first, second] if said else []
    assert stream.getvalue().splitlines() == [
        "hide: started",
        *middle,
        "a note",
        "hide: done in 1 min 1 s",
        "bad: failed: no pictures (log: bad.log)",
    ]


def test_what_failed_is_said_once_more_at_last() -> None:
    """After many stages, only the last lines are read. A stage that succeeds in the end did not fail."""
    events: list[Event] = [
        StageEnded("bad", "failed", "5e", 1.0, {}, "no pictures"),
        StageEnded("once", "failed", "5e", 1.0, {}, "a bad day"),
        StageEnded("once", "ran", "5e", 1.0, {}),
        *(StageEnded(f"fine[{number}]", "ran", "5e", 1.0, {}) for number in range(40)),
    ]
    stream = io.StringIO()
    with PlainLines(stream) as display:
        for event in events:
            display(event)
    assert stream.getvalue().splitlines()[-2:] == ["fine[39]: done in 1.0 s", "bad: failed: no pictures"]


@pytest.mark.parametrize(("skipped", "others", "times"), [(0, 0, 1), (5, 0, 1), (6, 0, 2), (0, 1, 2)])
def test_a_failure_in_sight_is_said_once(skipped: int, others: int, times: int) -> None:
    """Such a line may be long. If there are several, all are repeated together."""
    stream = io.StringIO()
    with PlainLines(stream) as display:
        for name in ("bad", *(f"other[{number}]" for number in range(others))):
            display(StageEnded(name, "failed", "5e", 1.0, {}, "no pictures"))
        for number in range(skipped):
            display(StageEnded(f"after[{number}]", "skipped", None, 0.0, {}, "needs bad, which was not made"))
    assert stream.getvalue().count("bad: failed: no pictures") == times


def test_beside_lines_for_programs_a_person_is_told_the_rest(capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.StringIO()
    with JsonLines(stream) as display:
        for event in [*EVENTS, Remarked("hide", "15 of 25 photos placed")]:
            display(event)
    assert [json.loads(line)["name"] for line in stream.getvalue().splitlines()] == ["cover", "hide", "bad"]
    assert capsys.readouterr().err.splitlines() == [
        "a note",
        "bad: failed: no pictures (log: bad.log)",
        "hide: 15 of 25 photos placed",
    ]
