"""What a person should know about a result is said when it is made, and again when the run ends."""

from __future__ import annotations

import io
from importlib import import_module
from pathlib import Path

import pytest
from rich.console import Console

from pipeline.code.fingerprint import read_module
from pipeline.console.live_table import LiveTable
from pipeline.console.progress import PlainLines
from pipeline.events import Remarked, StageEnded
from pipeline.run.cluster import DaskExecutor
from pipeline.stage import Remark, Stage
from tests.pipeline.helpers import Ran, Workspace

WORKFLOW = "name: doubtful\nvars: {number: 1.5}\nstages:\n  first: {uses: doubt, with: {number: '${number}'}}\n"
TOY = Path(__file__).parents[1] / "toys/doubt.py"
STAGES = Path(__file__).parents[3] / "stages"


def remarks(ran: Ran) -> list[Remarked]:
    return [event for event in ran.events if isinstance(event, Remarked)]


def log_of(workspace: Workspace) -> str:
    return (workspace.folder / "store/logs/doubtful/first.log").read_text()


def test_it_is_said_once_the_result_is_there(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path).write(WORKFLOW)
    ran = workspace.run()
    (remark,) = remarks(ran)
    assert (remark.name, remark.text) == ("first", "a doubtful number")
    assert remark.log
    assert remark.log.read_text() == log_of(workspace)
    assert "a doubtful number It is 1.5." in log_of(workspace)
    assert [type(event) for event in ran.events][-3:-1] == [StageEnded, Remarked]
    assert not remarks(workspace.run()), "nothing was made"


def test_nothing_is_said_of_what_is_as_it_should_be(tmp_path: Path) -> None:
    assert not remarks(Workspace(tmp_path).write(WORKFLOW).run("number=1.0"))


def test_a_defect_in_what_says_it_costs_no_result(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path).write(WORKFLOW)
    ran = workspace.run("number=2.5")
    assert ran.states == {"first": "ran"}
    assert not remarks(ran)
    assert "ZeroDivisionError: a defect" in log_of(workspace)


def test_a_worker_says_it_too(workspace: Workspace) -> None:
    (remark,) = remarks(workspace.write(WORKFLOW).run(executor=DaskExecutor(1)))
    assert remark.text == "a doubtful number"


def test_to_have_something_to_say_changes_no_key(tmp_path: Path) -> None:
    text = TOY.read_text()
    note = ', remarks="tests.pipeline.toys.doubt:doubts"'
    assert note in text
    digests = set()
    for content in (text, text.replace(note, "")):
        (tmp_path / "doubt.py").write_text(content)
        digests.add(read_module("doubt", tmp_path / "doubt.py").digest)
    assert len(digests) == 1


def test_what_is_as_wished_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.pipeline.toys.doubt.doubts", lambda finished: (Remark("all is well", as_wished=True),))
    (remark,) = remarks(Workspace(tmp_path).write(WORKFLOW).run())
    assert (remark.text, remark.as_wished) == ("all is well", True)


EVENT = Remarked("cover", "15 of 25 photos placed", Path("cover.log"))
WISHED = Remarked("cover", "25 of 25 photos placed", as_wished=True)
LINE = "cover: 15 of 25 photos placed (log: cover.log)"


def test_plain_lines_say_it_twice() -> None:
    stream = io.StringIO()
    with PlainLines(stream) as display:
        display(EVENT)
        display(StageEnded("hide", "ran", "5e", 61.0, {}))
    assert stream.getvalue().splitlines() == [LINE, "hide: done in 1 min 1 s", LINE]


def test_the_live_table_says_it_twice() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120, height=25, color_system=None)
    with LiveTable(console, "hide", 3) as display:
        display(EVENT)
        before = stream.getvalue()
    assert LINE in before
    assert LINE in stream.getvalue().removeprefix(before)


def test_what_is_as_wished_is_said_once() -> None:
    plain, terminal = io.StringIO(), io.StringIO()
    with PlainLines(plain) as display:
        display(WISHED)
    console = Console(file=terminal, force_terminal=True, width=120, height=25, color_system=None)
    with LiveTable(console, "hide", 3) as table:
        table(WISHED)
    assert plain.getvalue().count(WISHED.text) == terminal.getvalue().count(WISHED.text) == 1


@pytest.mark.parametrize("path", sorted(STAGES.glob("[!_]*.py")), ids=lambda path: path.stem)
def test_what_a_stage_names_is_there(path: Path) -> None:
    declared = getattr(import_module(f"stages.{path.stem}"), path.stem)
    assert isinstance(declared, Stage)
    if declared.remarks:
        module, _, function = declared.remarks.partition(":")
        assert callable(getattr(import_module(module), function))
