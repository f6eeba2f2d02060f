"""`gc` keeps all that a rerun of the kept runs needs, and what is pinned or young."""

from __future__ import annotations

import gc
import os
import shutil
import stat
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.errors import CommandError, UserError
from pipeline.store import garbage
from pipeline.store.garbage import Rules, collect
from pipeline.store.pins import Pin, Pins
from tests.pipeline.collecting import assert_sound, collected, is_cached, store_of
from tests.pipeline.helpers import CHAIN, Workspace


@pytest.fixture
def chain(workspace: Workspace) -> Workspace:
    return workspace.write(CHAIN)


def test_the_last_runs_stay_and_older_ones_go(chain: Workspace) -> None:
    factors = ["factor=2", "factor=3", "factor=4"]
    for factor in factors:
        chain.run(factor)
    collection = collected(chain, keep_last=2)
    assert [is_cached(chain, factor) for factor in factors] == [False, True, True]
    assert {(waste.workflow, waste.stage) for waste in collection.waste if waste.stage} == {
        ("chain", "twice"),
        ("chain", "sum"),
    }
    store = store_of(chain)
    named = {digest for record in store.records() for digest in record.outputs.values()}
    assert store.objects == named
    assert collection.results_kept == len(store.actions) == 6
    assert_sound(store)
    assert collected(chain, keep_last=2).size == 0, "there is nothing left to delete"


def test_runs_are_in_order_though_the_clock_was_wrong_once(chain: Workspace) -> None:
    """Otherwise, runs from when the clock was ahead would count as the last ones ever after."""
    chain.run("factor=2")
    for journal in store_of(chain).history.journals("chain"):
        journal.rename(journal.with_name(f"2999{journal.name[4:]}"))
    for factor in ("factor=3", "factor=4"):
        chain.run(factor)
    collected(chain, keep_last=2)
    assert [is_cached(chain, factor) for factor in ("factor=2", "factor=3", "factor=4")] == [False, True, True]


def test_what_cannot_be_made_again_stays(workspace: Workspace) -> None:
    """Such as the key of a scene hidden long ago: with it, a run makes the same container again, to the last bit."""
    workspace.write("""
        name: hides
        stages:
          cover: {uses: numbers}
          key:   {uses: draw, in: {of: cover}}
          hide:  {uses: scale, in: {numbers: key}}
        """)
    first = workspace.run()
    for number in range(7, 11):
        workspace.run(f"cover.first={number}")
    collected(workspace, keep_last=1)
    assert_sound(store_of(workspace))
    again = workspace.run()
    assert again.states == {"cover": "ran", "key": "cached", "hide": "ran"}
    assert again.ended["hide"].outputs == first.ended["hide"].outputs
    collected(workspace, keep_last=1, forgotten=frozenset({"hides"}))
    assert not store_of(workspace).actions


def test_a_dry_run_deletes_nothing(chain: Workspace) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    gc.collect()  # a run is a reference cycle, whose temporary folder goes with it: not while files are compared
    store = store_of(chain)
    before = sorted(path for path in store.root.rglob("*") if "locks" not in path.parts)
    collection = collect(store, Rules(keep_last=1))
    assert collection.size > 0
    assert sorted(path for path in store.root.rglob("*") if "locks" not in path.parts) == before
    size = sum(path.stat().st_size for path in store.root.rglob("*") if path.is_file())
    collection.delete()
    freed = size - sum(path.stat().st_size for path in store.root.rglob("*") if path.is_file())
    assert freed == collection.size


def test_a_run_of_a_part_pushes_nothing_out(chain: Workspace) -> None:
    """However many runs of one stage follow, the last whole run is kept."""
    chain.run("factor=2")
    for factor in (3, 4, 5):
        chain.run(f"factor={factor}", stages=["twice"])
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")
    assert chain.plan("factor=3")["twice"].state == "cached", "newer than what counts"


def test_an_interrupted_run_pushes_nothing_out(chain: Workspace) -> None:
    """The journal of a killed run has no end, so the run does not count."""
    chain.run("factor=2")
    for factor in (3, 4):
        chain.run(f"factor={factor}")
        journal = store_of(chain).history.journals("chain")[0]
        journal.write_text("".join(line for line in journal.read_text().splitlines(True) if "ended" not in line))
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")


def test_what_a_worker_finished_after_its_run_was_killed_stays(chain: Workspace) -> None:
    """The journal of that run only says that it was begun."""
    begun = str(chain.run("factor=2").ended["twice"].key)
    chain.run("factor=3")
    journal = store_of(chain).history.begin("chain", whole=True)
    journal.begin(begun)
    journal.close()
    collected(chain, keep_last=1)
    assert chain.plan("factor=2")["twice"].state == "cached"


def test_a_result_whose_line_was_lost_stays(chain: Workspace) -> None:
    """A full disk may cost a line of the journal; the link in `latest` is still there."""
    chain.run("factor=2")
    chain.run("factor=3")
    journal = store_of(chain).history.journals("chain")[0]
    lines = journal.read_text().splitlines(True)
    journal.write_text("".join(line for line in lines if '"name": "twice"' not in line))
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=3")
    assert is_cached(chain, "factor=2"), "a run with lost lines does not count"


def test_runs_that_fail_keep_what_succeeded_before(workspace: Workspace) -> None:
    """A stage's last result stays, with all that it was made from, though the last run did not make it."""
    text = """
        name: chain
        vars: {first: 0}
        stages:
          base: {uses: numbers, with: {first: "${first}"}}
          late: {uses: %s, in: {numbers: base}}
        """
    workspace.write(text % "scale").run("first=1")
    workspace.write(text % "fail")
    for first in (2, 3, 4):
        assert workspace.run(f"first={first}").states["late"] == "failed"
    collected(workspace, keep_last=1)
    workspace.write(text % "scale")
    assert is_cached(workspace, "first=1")
    assert workspace.plan("first=2")["base"].state == "run"
    assert workspace.plan("first=4")["base"].state == "cached"


def test_stages_that_are_no_longer_in_the_workflow_go(chain: Workspace) -> None:
    chain.run()
    chain.write("name: chain\nstages:\n  base: {uses: numbers}\n").run()
    collected(chain, keep_last=1)
    assert len(store_of(chain).actions) == 1
    assert set(store_of(chain).latest_digests()) == {"chain/base.numbers"}


def test_what_two_workflows_share_stays_for_both(chain: Workspace) -> None:
    chain.run()
    chain.write("name: other\nstages:\n  alone: {uses: numbers}\n").run()
    chain.write("name: chain\nstages:\n  new: {uses: numbers, with: {first: 5}}\n").run()
    collected(chain, keep_last=1)
    assert is_cached(chain.write("name: other\nstages:\n  alone: {uses: numbers}\n"))
    assert len(store_of(chain).actions) == 2


def test_a_pin_survives_a_power_cut(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is flushed after the pin has its name in it."""
    store, order, fsync, link = chain.run().project.store, [], os.fsync, os.link

    def flushed(descriptor: int) -> None:
        order.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def linked(source: Path, target: Path) -> None:
        order.append(str(target))
        link(source, target)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "link", linked)
    store.pins.add("paper", Pin("chain", "now", {}))
    folder = store.root / "pins"
    assert order[0] == str(store.root), "the folder's own name"
    assert order.index(str(folder / "paper.json")) < order.index(str(folder))


def test_nobody_else_can_read_a_pin(tmp_path: Path) -> None:
    """Not even in a folder that was opened by hand: names of stages may reveal a message."""
    folder, before = tmp_path / "pins", os.umask(0)
    try:
        Pins(folder).add("paper", Pin("chain", "now", {}))
    finally:
        os.umask(before)
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, folder / "paper.json")] == [0o700, 0o600]


def test_pins_keep_results_until_they_are_removed(chain: Workspace) -> None:
    pinned = chain.run("factor=2")
    store = store_of(chain)
    keys = {name: str(event.key) for name, event in pinned.ended.items()}
    store.pins.add("paper", Pin("chain", "now", keys))
    for factor in (3, 4):
        chain.run(f"factor={factor}")
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")
    assert not is_cached(chain, "factor=3")
    store.pins.remove("paper")
    collected(chain, keep_last=1)
    assert not is_cached(chain, "factor=2")


def test_a_pin_keeps_what_its_results_were_made_from(chain: Workspace) -> None:
    pinned = chain.run("count=2")
    store_of(chain).pins.add("sum", Pin("chain", "now", {"sum": str(pinned.ended["sum"].key)}))
    chain.run("count=3")
    collected(chain, keep_last=1)
    assert is_cached(chain, "count=2")


@pytest.mark.parametrize("name", ["", ".hidden", "../out", "a/b", "a/../../out", "a\n", "a" * 201])
def test_a_name_that_leads_elsewhere_is_not_given_to_a_pin(tmp_path: Path, name: str) -> None:
    with pytest.raises(CommandError, match="cannot name a pin"):
        Pins(tmp_path / "pins").add(name, Pin("chain", "now", {}))
    assert list(tmp_path.rglob("*")) == []


def test_a_pin_that_cannot_be_read_stops_everything(chain: Workspace) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    store = store_of(chain)
    store.folder("pins").joinpath("paper.json").write_text("{")
    with pytest.raises(UserError, match="the pin cannot be read"):
        collect(store, Rules(keep_last=1))


def test_a_record_that_cannot_be_read_stops_everything(chain: Workspace) -> None:
    """If a disk briefly fails to answer, what the record names must not be lost."""
    ran = chain.run("factor=2")
    store = store_of(chain)
    file = store.root / "actions" / str(ran.ended["base"].key) / "record.json"
    kept = file.read_bytes()
    file.write_bytes(b"")
    with pytest.raises(UserError, match="Run `verify` first"):
        collect(store, Rules(keep_last=1))
    file.write_bytes(kept)
    collected(chain)
    assert is_cached(chain, "factor=2")


def test_young_results_stay_on_request(chain: Workspace) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    collected(chain, keep_last=1, older_than=1.0)
    assert is_cached(chain, "factor=2")
    collected(chain, keep_last=1)
    assert not is_cached(chain, "factor=2")


@pytest.mark.parametrize(("hours", "stays"), [(47, True), (49, False)])
def test_what_is_young_is_told_in_days(
    chain: Workspace, monkeypatch: pytest.MonkeyPatch, hours: int, stays: bool
) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    later = time.time() + hours * 3600
    monkeypatch.setattr(garbage, "time", SimpleNamespace(time=lambda: later))
    collected(chain, keep_last=1, older_than=2.0)
    assert is_cached(chain, "factor=2") == stays


def test_a_forgotten_workflow_goes_with_its_logs(chain: Workspace) -> None:
    chain.run()
    chain.write("name: other\nstages:\n  alone: {uses: numbers, with: {first: 7}}\n").run()
    collected(chain, forgotten=frozenset({"chain"}))
    store = store_of(chain)
    assert len(store.actions) == 1
    assert store.history.workflows() == ["other"]
    assert set(store.latest_digests()) == {"other/alone.numbers"}
    assert sorted(path.name for path in (store.root / "logs").iterdir()) == ["other"]


def test_results_of_before_there_were_journals_stay(chain: Workspace) -> None:
    chain.run()
    store = store_of(chain)
    shutil.rmtree(store.root / "runs/chain")
    collected(chain, keep_last=1)
    assert len(store.actions) == 4
