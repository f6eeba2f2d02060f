"""The live table: on terminals of any width, with any number of stages."""

from __future__ import annotations

import io
import threading
from pathlib import Path

import pytest
from rich.console import Console, RenderableType

from pipeline.console import live_table
from pipeline.console.live_table import LiveTable
from pipeline.events import Event, Noted, StageEnded, StageProgressed, StageStarted


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(live_table, "time", clock)
    return clock


def console(width: int = 120, height: int = 25) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=width, height=height, color_system=None)


def shown(display: LiveTable, on: Console) -> list[str]:
    """The lines of the table at this moment."""
    with on.capture() as capture:
        on.print(display.table())
    return [line.rstrip() for line in capture.get().splitlines()]


def tell(display: LiveTable, clock: Clock, *events: Event, seconds: float = 10.0) -> None:
    for event in events:
        display(event)
        clock.now += seconds


def failed(name: str) -> StageEnded:
    return StageEnded(name, "failed", "5e", 1.0, {}, "no pictures", Path("bad.log"))


WORK: list[Event] = [
    StageStarted("hide"),
    StageProgressed("hide", 600, 1200, {"psnr": 21.5}),
    StageProgressed("hide", 700, 1200, {"psnr": 22.125}),
]


def test_a_row_for_what_runs_and_counts_of_the_rest(clock: Clock) -> None:
    """The remaining time follows from this run's pace: an earlier run had done the first half."""
    on = console()
    display = LiveTable(on, "hide_multi", 4)
    tell(display, clock, *WORK, StageEnded("cover", "cached", "5e", 0.0, {}), failed("bad"))
    whole, row, failure = shown(display, on)
    assert whole == "hide_multi  2 of 4 stages: 1 running, 1 failed, 1 cached, 0:50"
    assert row.split("━")[0] == "  hide "
    assert row.split("━")[-1].split() == ["58%", "0:50", "0:50", "left", "psnr", "22.12"]
    assert failure == "bad: failed: no pictures (log: bad.log)"


def test_names_are_counted_not_events(clock: Clock) -> None:
    """A stage whose result was damaged ends twice, and one that fails at first may succeed in the end."""
    on = console()
    display = LiveTable(on, "w", 2)
    ran = StageEnded("a", "ran", "5e", 1.0, {})
    tell(display, clock, StageEnded("a", "cached", "5e", 0.0, {}), StageStarted("a"), ran, failed("b"), seconds=0)
    assert shown(display, on)[0] == "w  2 of 2 stages: 1 ran, 1 failed, 0:00"
    tell(display, clock, StageEnded("b", "ran", "5e", 1.0, {}), seconds=0)
    assert shown(display, on) == ["w  2 of 2 stages: 2 ran, 0:00"]


@pytest.mark.parametrize("width", [20, 40, 60, 80, 100, 200])
def test_it_fits_the_terminal(clock: Clock, width: int) -> None:
    on = console(width)
    display = LiveTable(on, "hide_multi", 20)
    long = "message_splats[a very long name of a scene]"
    tell(display, clock, *WORK, StageStarted(long), StageProgressed(long, 1, 3, {"loss": 0.1, "psnr": 20.0}))
    tell(display, clock, failed(long * 3))
    lines = shown(display, on)
    assert len(lines) == 4, "no line is broken"
    assert all(len(line) <= width for line in lines)
    assert "58%" in lines[1]
    assert ("psnr 22.12" in lines[1]) == (width >= 40)
    assert ("━" in lines[1]) == (width >= 60)


def test_ten_thousand_stages(clock: Clock) -> None:
    """At most a screenful; only notes scroll by, and failures are repeated at the end."""
    on = console(height=20)
    with LiveTable(on, "batch", 10_000) as display:
        for number in range(9_000):
            display(StageEnded(f"stage[{number}]", "ran", "5e", 1.0, {}))
        for number in range(40):
            display(StageStarted(f"busy[{number}]"))
        for number in range(7):
            display(failed(f"bad[{number}]"))
        display(Noted("a note"))
    lines = shown(display, on)
    assert len(lines) <= 20
    assert lines[0] == "batch  9007 of 10000 stages: 40 running, 9000 ran, 7 failed, 0:00"
    assert "  and 30 more are running" in lines
    assert "  last done: stage[8999], stage[8998], stage[8997]" in lines
    assert lines[-1] == "and 2 more failed"
    assert lines[-2].startswith("bad[6]: failed")
    assert isinstance(on.file, io.StringIO)
    everything = on.file.getvalue()
    assert "stage[17]" not in everything
    assert "a note" in everything
    end = everything[everything.rindex("bad[0]") :]
    assert [line.split(":")[0] for line in end.splitlines() if line] == [f"bad[{number}]" for number in range(7)]


def test_of_few_stages_each_end_is_said(clock: Clock) -> None:
    on = console()
    with LiveTable(on, "w", 3) as display:
        tell(display, clock, *WORK, StageEnded("hide", "ran", "5e", 61.0, {}))
    assert isinstance(on.file, io.StringIO)
    assert "hide: done in 1 min 1 s" in on.file.getvalue()


def test_a_signal_may_tell_a_note_while_an_event_is_taken_and_the_table_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawing = threading.Event()

    class Watched(LiveTable):
        def table(self) -> RenderableType:
            drawing.set()
            return super().table()

    on = console()
    display = Watched(on, "w", 3)

    def interrupted(event: StageEnded) -> str:
        drawing.clear()
        assert drawing.wait(10), "the thread that draws is at it"
        display(Noted("stopping"))
        return "made"

    def work() -> None:
        with display:
            display(StageEnded("hide", "ran", "5e", 61.0, {}))

    monkeypatch.setattr(live_table, "ending", interrupted)
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(30)
    assert not thread.is_alive(), "each waits for the other"
    assert isinstance(on.file, io.StringIO)
    everything = on.file.getvalue()
    assert everything.count("stopping") == everything.count("made") == 1
