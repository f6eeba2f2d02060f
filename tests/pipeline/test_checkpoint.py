"""Checkpoints: complete or absent, one at a time, private, and rare enough to cost next to nothing."""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pipeline.checkpoint
from pipeline.artifact import Artifact
from pipeline.checkpoint import EVERY, EVERY_VARIABLE, LONGEST, Checkpoints, State
from pipeline.errors import Interrupted, UserError
from pipeline.events import Noted
from pipeline.manifest import read_manifest
from pipeline.stage import Context, Services
from pipeline.store.store import Store
from tests.pipeline.helpers import Workspace

STATE = State(
    {
        "weights/0": np.linspace(0, 1, 7, dtype=np.float32).reshape(7, 1),
        "weights/1": np.array([[np.nan, -np.inf]], np.float32),
        "steps": np.array(3.0, np.float32),
        "none": np.zeros((4, 0, 3), np.float32),
        "seen": np.array([True, False]),
        "generator": np.arange(250, dtype=np.uint8),
        "counts": np.array([[-5, 2**40]]),
        "figures": np.array([0.1]),
    },
    {"iteration": 3, "remaining": [2, 0], "seconds": 0.1},
)


@pytest.fixture(autouse=True)
def no_wishes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(EVERY_VARIABLE, raising=False)


@pytest.fixture
def log() -> list[str]:
    return []


@pytest.fixture
def context(tmp_path: Path, log: list[str]) -> Context:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    return Context({}, {}, scratch, "test", Services(log=log.append))


def same(found: State, expected: State = STATE) -> bool:
    arrays = [
        {name: (array.dtype.str, array.shape, array.tobytes()) for name, array in state.arrays.items()}
        for state in (found, expected)
    ]
    return arrays[0] == arrays[1] and found.values == expected.values


def numbered(number: int) -> State:
    return State({"number": np.array(number)}, {})


def number_in(context: Context) -> int | None:
    found = Checkpoints(context).newest()
    return int(found.state.arrays["number"]) if found else None


def test_what_is_saved_comes_back_bit_for_bit(context: Context, log: list[str]) -> None:
    assert Checkpoints(context).newest() is None
    Checkpoints(context, ["numpy"]).save(STATE)
    found = Checkpoints(context, ["numpy"]).newest()
    assert found
    assert same(found.state)
    assert log == []


def test_one_remains(context: Context) -> None:
    checkpoints = Checkpoints(context)
    for number in range(12):
        checkpoints.save(numbered(number))
        assert len(list(context.scratch.iterdir())) == 1
        assert number_in(context) == number


def test_nobody_else_can_read_them(context: Context) -> None:
    before = os.umask(0)
    try:
        Checkpoints(context).save(STATE)
    finally:
        os.umask(before)
    (checkpoint,) = context.scratch.iterdir()
    for path in (checkpoint, *checkpoint.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)


def test_what_a_kill_left_behind_does_no_harm(context: Context) -> None:
    """Half a checkpoint, not yet renamed; or a new one, with the old one still there, whole or half deleted."""
    Checkpoints(context).save(numbered(1))
    shutil.copytree(context.scratch / "checkpoint-1", context.scratch / ".checkpoint-0123")
    (context.scratch / ".checkpoint-0123" / "manifest.json").unlink()
    assert number_in(context) == 1
    old = context.scratch.with_name("old")
    shutil.copytree(context.scratch / "checkpoint-1", old)
    Checkpoints(context).save(numbered(2))
    shutil.copytree(old, context.scratch / "checkpoint-1")
    assert number_in(context) == 2
    (context.scratch / "checkpoint-1" / "manifest.json").unlink()
    assert number_in(context) == 2
    Checkpoints(context).save(numbered(3))
    assert [path.name for path in context.scratch.iterdir()] == ["checkpoint-3"]


def test_the_tenth_is_newer_than_the_ninth(context: Context) -> None:
    """Both are there if a kill came before the old one was deleted."""
    for number in range(1, 10):
        Checkpoints(context).save(numbered(number))
    ninth = context.scratch / "checkpoint-9"
    shutil.copytree(ninth, context.scratch.with_name("old"))
    Checkpoints(context).save(numbered(10))
    context.scratch.with_name("old").rename(ninth)
    assert number_in(context) == 10


def test_a_damaged_one_gives_way_to_the_one_before(context: Context, log: list[str]) -> None:
    Checkpoints(context).save(numbered(1))
    shutil.copytree(context.scratch / "checkpoint-1", context.scratch.with_name("old"))
    Checkpoints(context).save(numbered(2))
    context.scratch.with_name("old").rename(context.scratch / "checkpoint-1")
    (context.scratch / "checkpoint-2" / "manifest.json").write_text("torn")
    assert number_in(context) == 1
    assert len(log) == 1
    assert log[0].startswith("checkpoint-2 cannot be used: ")


def test_the_old_one_goes_only_when_the_new_one_is_in_place(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    Checkpoints(context).save(numbered(1))

    class Killed(BaseException):
        pass

    def killed(artifact: Artifact, directory: Path) -> Artifact:
        raise Killed

    monkeypatch.setattr(pipeline.checkpoint, "publish", killed)
    with pytest.raises(Killed):
        Checkpoints(context).save(numbered(2))
    assert number_in(context) == 1


def test_a_full_disk_stops_no_work(context: Context, log: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    Checkpoints(context).save(numbered(1))

    def full(artifact: Artifact, directory: Path) -> Artifact:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pipeline.checkpoint, "publish", full)
    Checkpoints(context).save(numbered(2))
    assert log == ["the checkpoint could not be written: [Errno 28] No space left on device"]
    assert [path.name for path in context.scratch.iterdir()] == ["checkpoint-1"]
    assert number_in(context) == 1


@contextmanager
def full_for(saves: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The disk refuses the first `saves` checkpoints."""
    publish, left = pipeline.checkpoint.publish, iter(range(saves))

    def full(artifact: Artifact, directory: Path) -> Artifact:
        if next(left, None) is not None:
            raise OSError(28, "No space left on device")
        return publish(artifact, directory)

    with monkeypatch.context() as patch:
        patch.setattr(pipeline.checkpoint, "publish", full)
        yield


def test_the_run_says_that_a_disk_is_full_while_work_goes_on(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once, not every minute; and if the work stops, its cause says that the last checkpoint was not written."""
    workspace.write("stages:\n  a: {uses: keep}\n")
    with full_for(2, monkeypatch):
        ran = workspace.run()
    (note,) = (event.text for event in ran.events if isinstance(event, Noted))
    assert note == (
        "a: its checkpoint could not be written: No space left on device. If it stops before one can be written, "
        f"its work since the last one is lost: check the disk that holds {workspace.folder / 'store'} now."
    )
    assert ran.ended["a"].cause == (
        "stopped after number 2; its checkpoint could not be written: No space left on device"
    )


def test_the_run_says_that_there_is_room_again(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace.write("stages:\n  a: {uses: keep}\n")
    with full_for(1, monkeypatch):
        ran = workspace.run()
    notes = [event.text for event in ran.events if isinstance(event, Noted)]
    assert notes[1:] == ["a: its checkpoints can be written again"]
    assert ran.ended["a"].cause == "stopped after number 2"


def rewrite(checkpoint: Path, change: dict[str, object]) -> None:
    """Makes it the checkpoint of another program, with other attributes and a manifest that fits them."""
    manifest = read_manifest(checkpoint)
    replace(manifest, attributes={**manifest.attributes, **change}).write(checkpoint)


def test_another_format_is_not_read(context: Context, log: list[str]) -> None:
    Checkpoints(context).save(STATE)
    rewrite(context.scratch / "checkpoint-1", {"format": 2})
    assert Checkpoints(context).newest() is None
    assert log == ["checkpoint-1 cannot be used: its format is 2; this program reads 1"]


def test_other_versions_and_circumstances_are_named(context: Context, log: list[str]) -> None:
    Checkpoints(context, circumstances={"device": "a GPU", "torch": "2.12"}).save(STATE)
    found = Checkpoints(context, circumstances={"device": "a CPU", "torch": "2.13"}).newest()
    assert found
    assert same(found.state)
    assert log == [
        "the checkpoint was written with device a GPU, now a CPU; torch 2.12, now 2.13: "
        "the result may differ in its last bits"
    ]


class Clock:
    """A clock that only a test moves."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@contextmanager
def saves_take(seconds: float, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    publish = pipeline.checkpoint.publish

    def slow(artifact: Artifact, directory: Path) -> Artifact:
        clock.now += seconds
        return publish(artifact, directory)

    with monkeypatch.context() as patch:
        patch.setattr(pipeline.checkpoint, "publish", slow)
        yield


@pytest.mark.parametrize(("cost", "pause"), [(0.0, EVERY), (0.5, EVERY), (2.0, 200.0), (60.0, LONGEST)])
def test_the_pause_follows_from_the_cost(
    cost: float, pause: float, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    checkpoints = Checkpoints(context, clock=clock)
    clock.now += EVERY - 0.5
    assert not checkpoints.due()
    clock.now += 1
    assert checkpoints.due()
    with saves_take(cost, clock, monkeypatch):
        checkpoints.save(STATE)
    clock.now += pause - 0.5
    assert not checkpoints.due()
    clock.now += 1
    assert checkpoints.due()


def test_the_environment_may_set_the_pause(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setenv(EVERY_VARIABLE, "2.5")
    checkpoints = Checkpoints(context, clock=clock)
    with saves_take(30, clock, monkeypatch):
        checkpoints.save(STATE)
    clock.now += 2
    assert not checkpoints.due()
    clock.now += 1
    assert checkpoints.due()
    monkeypatch.setenv(EVERY_VARIABLE, "often")
    with pytest.raises(UserError, match=f"{EVERY_VARIABLE}: not a number of seconds; found often"):
        Checkpoints(context)


def test_a_loop_saves_what_is_due_and_what_a_stop_would_lose(tmp_path: Path) -> None:
    clock, asked = Clock(), False
    context = Context({}, {}, tmp_path, "test", Services(stop_requested=lambda: asked))
    checkpoints = Checkpoints(context, every=10, clock=clock)
    saved = []
    for number in range(4):
        checkpoints.save_or_stop(lambda now=number: numbered(now), "stopped")
        saved.append(number_in(context))
        clock.now += 5
    assert saved == [None, None, 2, 2]
    asked = True
    with pytest.raises(Interrupted, match="stopped after number 4"):
        checkpoints.save_or_stop(lambda: numbered(4), "stopped after number 4")
    assert number_in(context) == 4


def test_a_checkpoint_knows_what_it_took(tmp_path: Path) -> None:
    """Over all sessions, but without what came after each checkpoint."""
    clock = Clock()

    def session(seconds: float) -> float:
        context = Context({}, {}, tmp_path, "test", Services())
        checkpoints = Checkpoints(context, clock=clock)
        checkpoints.newest()
        clock.now += seconds
        checkpoints.save(STATE)
        clock.now += 1000  # nothing of what comes after a checkpoint is kept
        return context.seconds_before

    assert [session(seconds) for seconds in (30, 5, 1)] == [0, 30, 35]


def test_seconds_before_a_checkpoint_are_seconds_of_the_stage(workspace: Workspace) -> None:
    ran = workspace.write("stages:\n  a: {uses: resumed}\n").run()
    assert ran.ended["a"].seconds >= 1000
    record = json.loads(next(workspace.folder.glob("store/actions/*/record.json")).read_text())
    assert record["provenance"]["seconds"] >= 1000


def test_it_goes_only_when_the_result_is_in_the_store(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the disk is full just then, the next run goes on from it."""
    step = workspace.write("stages:\n  a: {uses: numbers}\n").plan()["a"]
    store = workspace.open().store
    checkpoint = store.folder("scratch", str(step.key)) / "checkpoint"
    checkpoint.write_text("hours of work")

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Store, "commit", full)
        assert workspace.run().states == {"a": "failed"}
    assert checkpoint.read_text() == "hours of work"
    assert workspace.run().states == {"a": "ran"}
    assert not checkpoint.exists()
