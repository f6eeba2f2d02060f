"""What may pass is tried again, and nothing else; a dead worker's stage only if it had not begun."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from pipeline.errors import Unreachable
from pipeline.events import Noted
from pipeline.resources import Resources
from pipeline.run import runner
from pipeline.run.action import Job
from pipeline.run.executor import Lost, SerialExecutor, Tell, Work
from pipeline.store.store import Store
from tests.pipeline.helpers import Ran, Workspace


class Waits:
    """A clock on which time passes only while something sleeps."""

    def __init__(self) -> None:
        self.slept = 0.0

    def monotonic(self) -> float:
        return self.slept

    def sleep(self, seconds: float) -> None:
        self.slept += seconds


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> Waits:
    waits = Waits()
    monkeypatch.setattr(runner, "time", waits)
    return waits


class Deadly(SerialExecutor):
    """Its worker dies `deaths` times: before the work begins, after that, or when all is done."""

    def __init__(self, deaths: int, when: str) -> None:
        super().__init__()
        self.deaths = deaths
        self.when = when

    def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
        if not self.deaths or not self._waiting:
            return super().wait(tell, seconds)
        self.deaths -= 1
        _, name, work, job = self._waiting.pop(0)
        assert isinstance(job, Job)
        if self.when == "begun":
            job.begun_flag.touch()
        if self.when == "done":
            work(job, tell)
        return name, Lost("its worker process died", transient=True)


class Distant(SerialExecutor):
    """Its workers are on a machine that has the run's address of a bucket, and not the folder of its flags."""

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        assert isinstance(subject, Job)
        nowhere = Path("/nowhere")
        there = replace(subject, stop_flag=nowhere / "stop", begun_flag=nowhere / "begun")
        super().start(name, work, there, urgency, needs)


def test_workers_need_not_see_the_flags_of_the_run(workspace: Workspace) -> None:
    ran = workspace.write("stages:\n  a: {uses: numbers}\n").run(executor=Distant())
    assert ran.states == {"a": "ran"}


def said(ran: Ran) -> deque[str]:
    return deque(event.text for event in ran.events if isinstance(event, Noted))


def test_transient_errors_are_tried_again_with_growing_waits(workspace: Workspace, waits: Waits) -> None:
    ran = workspace.write("stages:\n  a: {uses: flaky, with: {failures: 3}}\n").run()
    assert ran.states == {"a": "ran"}
    assert list(said(ran)) == [
        "a: the connection broke off; trying again in 2 s (1 of 3)",
        "a: the connection broke off; trying again in 8 s (2 of 3)",
        "a: the connection broke off; trying again in 32 s (3 of 3)",
    ]
    assert 42 <= waits.slept < 43


def test_inputs_are_fetched_again_from_a_bucket_that_was_not_reached(
    workspace: Workspace, waits: Waits, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a}}\n").run(stages=["a"])
    broken = [Unreachable("the connection broke off")]

    class Far(SerialExecutor):
        def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
            with monkeypatch.context() as work:
                if broken:
                    work.setattr(Store, "artifact", Mock(side_effect=broken.pop()))
                return super().wait(tell, seconds)

    ran = workspace.run(executor=Far())
    assert ran.states == {"a": "cached", "b": "ran"}
    assert list(said(ran)) == ["b: the connection broke off; trying again in 2 s (1 of 3)"]


def test_a_bucket_that_does_not_say_what_is_done_is_asked_again(
    workspace: Workspace, waits: Waits, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the run itself, which would otherwise end all that runs; but not for ever if there is nothing else to do."""
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a}}\n")
    find, left = Store.find, 2

    def find_now_and_then(store: Store, key: str) -> object:
        nonlocal left
        left -= 1
        if left >= 0:
            raise Unreachable("the server cannot be reached")
        return find(store, key)

    monkeypatch.setattr(Store, "find", find_now_and_then)
    ran = workspace.run()
    assert ran.states == {"a": "ran", "b": "ran"}
    assert [text.partition("; ")[2] for text in said(ran)] == [
        "trying again in 2 s (1 of 3)",
        "trying again in 8 s (2 of 3)",
    ]
    left = 1000
    with pytest.raises(Unreachable, match="cannot be reached"):
        workspace.run()


def test_what_waits_for_others_is_not_looked_for_all_the_time(
    workspace: Workspace, waits: Waits, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: measure}\n")
    asked: list[str] = []
    find = Store.find
    monkeypatch.setattr(Store, "find", lambda store, key: (asked.append(key), find(store, key))[1])

    class Slow(SerialExecutor):
        rounds = 20

        def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
            self.rounds -= 1
            return None if self.rounds > 0 else super().wait(tell, seconds)

    assert workspace.run(executor=Slow()).states == {"a": "ran", "b": "ran"}
    assert len(asked) <= 8


def test_not_for_ever(workspace: Workspace, waits: Waits) -> None:
    workspace.write("stages:\n  a: {uses: flaky, with: {failures: 9}}\n  b: {uses: scale, in: {numbers: a}}\n")
    ran = workspace.run()
    assert ran.states == {"a": "failed", "b": "skipped"}
    assert ran.ended["a"].cause == "the connection broke off"
    (attempts,) = workspace.folder.glob("store/scratch/*/attempts")
    assert len(attempts.read_text()) == 4


def test_other_stages_go_on_meanwhile(workspace: Workspace, waits: Waits) -> None:
    ran = workspace.write("stages:\n  a: {uses: flaky}\n  b: {uses: numbers}\n").run()
    assert list(ran.ended) == ["b", "a"]


@pytest.mark.parametrize("how", ["user", "defect"])
def test_other_errors_are_not_tried_again(workspace: Workspace, waits: Waits, how: str) -> None:
    workspace.write(
        f"stages:\n  base: {{uses: numbers}}\n  a: {{uses: fail, in: {{numbers: base}}, with: {{how: {how}}}}}\n"
    )
    ran = workspace.run()
    assert (ran.states["a"], list(said(ran)), waits.slept) == ("failed", [], 0.0)


@pytest.mark.parametrize(
    ("deaths", "when", "state", "repeats"),
    [(2, "before", "ran", 2), (9, "before", "failed", 3), (1, "begun", "failed", 0), (1, "done", "ran", 0)],
)
def test_a_worker_that_dies(
    workspace: Workspace, waits: Waits, deaths: int, when: str, state: str, repeats: int
) -> None:
    """Before the stage begins, it is not the stage's fault; while it runs, it may be; after its end, all is kept."""
    workspace.write("stages:\n  a: {uses: numbers}\n")
    ran = workspace.run(executor=Deadly(deaths, when))
    assert (ran.states, len(said(ran))) == ({"a": state}, repeats)
    assert not list(Path(workspace.folder / "store/temporary").glob("*/*")), "no flag is left behind"


def test_other_stages_go_on_if_a_worker_dies_and_the_bucket_does_not_say_what_it_had_done(
    workspace: Workspace, waits: Waits, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: numbers, with: {count: 4}}\n")
    find, broken = Store.find, list[Unreachable]()

    def find_unless_broken(store: Store, key: str) -> object:
        if broken:
            raise broken.pop()
        return find(store, key)

    class Cut(Deadly):
        def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
            ended = super().wait(tell, seconds)
            if ended and isinstance(ended[1], Lost):
                broken.append(Unreachable("the server cannot be reached"))
            return ended

    monkeypatch.setattr(Store, "find", find_unless_broken)
    ran = workspace.run(executor=Cut(1, "begun"))
    assert sorted(ran.states.values()) == ["failed", "ran"]
