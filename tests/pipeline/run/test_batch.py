"""Batches: rows of a foreach share the work that they have in common, and a failed row holds up no other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.events import StageEnded
from pipeline.run.cause import cause_of, lasting_words
from tests.pipeline.helpers import Ran, Workspace
from tests.pipeline.run.test_runner import Watched

BATCH = """
    name: batch
    vars: {pairs: pairs.csv}
    stages:
      left:   {uses: numbers, foreach: "${pairs}", with: {file: "${item.left}"}}
      right:  {uses: numbers, foreach: "${pairs}", with: {file: "${item.right}"}}
      scaled: {uses: scale, foreach: "${pairs}", in: {numbers: right}}
      both:   {uses: total, foreach: "${pairs}", in: {numbers: [left, scaled]}}
      page:   {uses: table, in: {numbers: {all: both.total, without_failed: true}}}
    """
STATES = {
    "left[a.txt]": "ran",
    "right[b.txt]": "ran",
    "right[bad.txt]": "failed",
    "right[a.txt]": "cached",  # left[a.txt] is the same action
    "scaled[b.txt]": "ran",
    "scaled[bad.txt]": "skipped",
    "scaled[a.txt]": "ran",
    "both[a.txt,b.txt]": "ran",
    "both[a.txt,bad.txt]": "skipped",
    "both[a.txt,a.txt]": "ran",
    "page": "ran",
}
CAUSE = "right: ValueError: could not convert string 'oops' to float64 at row 0, column 1."


@pytest.fixture
def batch(workspace: Workspace) -> Workspace:
    folder = workspace.folder
    for name, text in {"a.txt": "1\n2\n", "b.txt": "3\n", "bad.txt": "oops\n"}.items():
        (folder / name).write_text(text)
    (folder / "pairs.csv").write_text("left,right\na.txt,b.txt\na.txt,bad.txt\na.txt,a.txt\n")
    return workspace.write(BATCH)


def rows(ran: Ran) -> list[str]:
    return ran.artifact("page", "page").file("rows.txt").read_text().splitlines()


def test_one_report_with_a_row_for_each_pair(batch: Workspace) -> None:
    ran = batch.run()
    assert ran.states == STATES
    assert rows(ran) == [
        "a.txt,b.txt {'left': 'a.txt', 'right': 'b.txt'} sum 9",
        f"a.txt,bad.txt {{'left': 'a.txt', 'right': 'bad.txt'}} {CAUSE}",
        "a.txt,a.txt {'left': 'a.txt', 'right': 'a.txt'} sum 9",
    ]
    again = batch.run()
    assert again.states == {name: "cached" if state == "ran" else state for name, state in STATES.items()}
    assert again.ended["page"].key == ran.ended["page"].key, "the same failure makes the same key"


def test_the_report_is_made_again_when_a_failed_pair_succeeds(batch: Workspace) -> None:
    first = batch.run()
    (batch.folder / "bad.txt").write_text("10\n")
    plan = batch.plan()
    assert {name for name, step in plan.items() if step.state == "run"} == {
        "right[bad.txt]",
        "scaled[bad.txt]",
        "both[a.txt,bad.txt]",
    }
    assert plan["page"].state == "depends"
    assert plan["page"].reasons == (
        "input numbers waits for both[a.txt,bad.txt], which the last result was made without",
    )
    second = batch.run()
    assert second.states["page"] == "ran"
    assert second.ended["page"].key != first.ended["page"].key
    assert rows(second)[1].endswith("sum 23")
    assert set(batch.run().states.values()) == {"cached"}
    assert {step.state for step in batch.plan().values()} == {"cached"}


def test_another_cause_makes_the_report_again(batch: Workspace) -> None:
    batch.run()
    (batch.folder / "bad.txt").write_text("7\nworse\n")
    ran = batch.run()
    assert ran.states["page"] == "ran"
    assert "'worse'" in rows(ran)[1]


def test_a_renamed_row_makes_the_report_again_and_nothing_else(batch: Workspace) -> None:
    batch.run()
    (batch.folder / "pairs.csv").write_text("left,right\na.txt,b.txt\na.txt,bad.txt\na.txt,./a.txt\n")
    assert batch.plan()["page"].reasons[-1] == "input numbers: a.txt,a.txt → a.txt,.:a.txt"
    assert {name for name, state in batch.run().states.items() if state == "ran"} == {"page"}


def test_a_report_of_failures_alone(batch: Workspace) -> None:
    (batch.folder / "pairs.csv").write_text("left,right\na.txt,bad.txt\n")
    assert rows(batch.run()) == [f"a.txt,bad.txt {{'left': 'a.txt', 'right': 'bad.txt'}} {CAUSE}"]


def test_what_does_not_say_which_failed_needs_one_that_did_not(workspace: Workspace) -> None:
    workspace.write("""
        stages:
          base: {uses: numbers}
          bad:  {uses: fail, in: {numbers: base}, with: {how: user}}
          sum:  {uses: total, in: {numbers: {all: bad, without_failed: true}}}
        """)
    ran = workspace.run()
    assert ran.states["sum"] == "failed"
    assert "everything failed that is taken as 'numbers'" in str(ran.ended["sum"])


def test_without_being_told_so_nothing_goes_on(batch: Workspace) -> None:
    batch.write(BATCH.replace("without_failed: true", "without_failed: false"))
    assert batch.run().states == STATES | {"page": "skipped"}


def test_the_cause_is_the_same_wherever_files_lie(batch: Workspace, tmp_path: Path) -> None:
    """Neither the folder of the files nor that of the store is part of it."""
    first = batch.run().ended["page"].key
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for file in batch.folder.glob("*.*"):
        (moved / file.name).write_bytes(file.read_bytes())
    assert Workspace(moved).write(BATCH).run().ended["page"].key == first


def test_the_report_waits_for_all_pairs(batch: Workspace) -> None:
    """Each pair ends, one way or the other, before the report begins."""
    ran = batch.run(executor=Watched())
    names = [event.name for event in ran.events if isinstance(event, StageEnded)]
    assert names[-1] == "page"
    assert ran.states == STATES


def test_which_cause_is_told_does_not_depend_on_which_failure_came_first(workspace: Workspace) -> None:
    """Both `slow` and `quick` fail; a stage that takes both gives the cause of the one listed first."""
    workspace.write("""
        stages:
          base:  {uses: numbers}
          quick: {uses: fail, in: {numbers: base}, with: {how: user}}
          late:  {uses: scale, in: {numbers: base}}
          slow:  {uses: fail, in: {numbers: late}, with: {how: defect}}
          both:  {uses: total, in: {numbers: [slow, quick]}}
          page:  {uses: table, in: {numbers: {all: [both.total, base], without_failed: true}}}
        """)
    assert rows(workspace.run()) == ["both {} slow: ZeroDivisionError: division by zero", "base {} sum 3"]


def test_one_node_for_all_rows_that_are_equal_in_what_it_uses(workspace: Workspace) -> None:
    workspace.write("""
        vars: {rows: [{a: 1, b: 5}, {a: 2, b: 5}, {a: 1, b: 6}]}
        stages:
          first:  {uses: numbers, foreach: "${rows}", with: {first: "${item.a}", count: 1}}
          second: {uses: numbers, foreach: "${rows}", with: {first: "${item.b}", count: 1}}
          scaled: {uses: scale, foreach: "${rows}", in: {numbers: first}}
          both:   {uses: total, foreach: "${rows}", in: {numbers: [scaled, second]}}
          none:   {uses: numbers, foreach: "${rows}"}
          all:    {uses: total, in: {numbers: scaled}}
        """)
    ran = workspace.run()
    assert list(ran.project.graph.nodes) == [
        *("first[1]", "first[2]", "second[5]", "second[6]", "scaled[1]", "scaled[2]"),
        *("both[1,5]", "both[2,5]", "both[1,6]", "none", "all"),
    ]
    np.testing.assert_array_equal(ran.values("both[1,6]", "total"), [2.0, 6.0])
    np.testing.assert_array_equal(ran.values("all", "total"), [2.0, 4.0, 2.0])  # one for each row, in order


def test_equal_work_is_planned_once(workspace: Workspace) -> None:
    """Even if only the plan knows that two stages will get the same input."""
    workspace.write("""
        stages:
          a:     {uses: numbers}
          b:     {uses: numbers}
          twice: {uses: scale, in: {numbers: a}}
          again: {uses: scale, in: {numbers: b}}
          other: {uses: scale, in: {numbers: b}, with: {factor: 3}}
        """)
    plan = workspace.plan()
    assert {name: step.state for name, step in plan.items()} == {
        "a": "run",
        "b": "shared",
        "twice": "run",
        "again": "shared",
        "other": "run",
    }
    assert plan["again"].reasons == ("does the same as twice",)
    assert workspace.run().states == {"a": "ran", "b": "cached", "twice": "ran", "again": "cached", "other": "ran"}


def test_rows_from_yaml_and_from_csv_are_the_same_actions(workspace: Workspace) -> None:
    text = """
        stages:
          each: {uses: numbers, foreach: FOREACH, with: {first: "${item.first}", note: "${item.note}", count: 1}}
          page: {uses: table, in: {numbers: each}}
        """
    (workspace.folder / "rows.csv").write_text('first,note\n0.5,reef\n1e-4,"2"\n-3,2020-01-01\n')
    rows = [{"first": 0.5, "note": "reef"}, {"first": 1e-4, "note": "2"}, {"first": -3, "note": "2020-01-01"}]
    columns = {name: [row[name] for row in rows] for name in ("first", "note")}
    keys = []
    for foreach in ("rows.csv", json.dumps(rows), json.dumps(columns)):
        keys.append([event.key for event in workspace.write(text.replace("FOREACH", foreach)).run().ended.values()])
    assert keys[0] == keys[1] == keys[2]


def test_a_cause_says_to_its_end_what_to_do() -> None:
    """In a batch, it is read in a table, possibly far from the store and its logs."""
    told = str(UserError("no photos", found="x" * 400, expected="photos " * 100, remedy="Take others."))
    assert lasting_words(told) == told.replace("  ", " ")
    assert lasting_words("endless " * 10_000).endswith("…")


def test_a_lack_of_memory_says_what_to_do_and_lasts(tmp_path: Path) -> None:
    """Torch's words for a GPU's tell how much each process has at that moment."""
    said = (
        "CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 79.15 GiB of which {} is free. "
        "Process {} has {} memory in use. Of the allocated memory {} is allocated by PyTorch, and {} is reserved by "
        "PyTorch but unallocated."
    )
    for_gpu = type("OutOfMemoryError", (RuntimeError,), {})
    once = cause_of(for_gpu(said.format("1.20 GiB", 4711, "9.50 GiB", "8.00 GiB", "12.5 MiB")), tmp_path)
    again = cause_of(for_gpu(said.format("3.40 GiB", 4712, "7.00 GiB", "6.00 GiB", "800.00 KiB")), tmp_path)
    assert "Tried to allocate 2.00 GiB" in once
    assert "--workers 1" in once
    assert lasting_words(once) == lasting_words(again)
    for_machine = RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes.")
    for error in (for_machine, MemoryError("Unable to allocate 3.00 GiB")):
        assert "--workers 1" in cause_of(error, tmp_path)
    assert cause_of(RuntimeError("no memory of it"), tmp_path) == "RuntimeError: no memory of it"
