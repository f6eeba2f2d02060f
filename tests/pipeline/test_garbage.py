"""`gc`: what is kept is all that a rerun of the kept runs needs, and wherever it breaks off the store is valid."""

from __future__ import annotations

import errno
import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.disk import remove_where_it_lies
from pipeline.errors import CommandError, UserError
from pipeline.garbage import CHECKPOINT_DAYS, JOURNALS_KEPT, Collection, Rules, collect
from pipeline.pins import Pin
from pipeline.remote import open_store
from pipeline.store import Store
from pipeline.temporary import left_behind
from pipeline.verification import verify_store
from tests.pipeline.helpers import Workspace
from tests.pipeline.test_runner import CHAIN

ROOT = Path(__file__).parents[2]


@pytest.fixture
def chain(workspace: Workspace) -> Workspace:
    return workspace.write(CHAIN)


def store_of(workspace: Workspace) -> Store:
    return open_store(workspace.folder / "store")


def collected(workspace: Workspace, **rules: object) -> Collection:
    store = store_of(workspace)
    with store.in_use(alone=True):
        collection = collect(store, Rules(**rules))  # type: ignore[arg-type]
        collection.delete()
    return collection


def is_cached(workspace: Workspace, *settings: str) -> bool:
    return all(step.state == "cached" for step in workspace.plan(*settings).values())


def assert_sound(store: Store) -> None:
    assert [checked for checked in verify_store(store) if checked.damage] == []


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


def test_a_dry_run_deletes_nothing(chain: Workspace) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    gc.collect()  # a run's own temporary folder goes with it, and a run is a cycle: not while what is there is compared
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
    """However many runs of one stage follow, the last whole run is still all there."""
    chain.run("factor=2")
    for factor in (3, 4, 5):
        chain.run(f"factor={factor}", stages=["twice"])
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")
    assert chain.plan("factor=3")["twice"].state == "cached", "newer than what counts"


def test_an_interrupted_run_pushes_nothing_out(chain: Workspace) -> None:
    """A killed run's journal has no end, and so it does not count."""
    chain.run("factor=2")
    for factor in (3, 4):
        chain.run(f"factor={factor}")
        journal = store_of(chain).history.journals("chain")[0]
        journal.write_text("".join(line for line in journal.read_text().splitlines(True) if "ended" not in line))
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")


def test_a_result_whose_line_was_lost_stays(chain: Workspace) -> None:
    """A full disk costs a line of the journal; the link in `latest` is there all the same."""
    chain.run("factor=2")
    chain.run("factor=3")
    journal = store_of(chain).history.journals("chain")[0]
    lines = journal.read_text().splitlines(True)
    journal.write_text("".join(line for line in lines if '"name": "twice"' not in line))
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=3")
    assert is_cached(chain, "factor=2"), "a run with lost lines does not count"


def test_runs_that_fail_keep_what_succeeded_before(workspace: Workspace) -> None:
    """The last result of a stage stays, with all that it was made from, though that is not of the last run."""
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
    pinned = chain.run("factor=2")
    store_of(chain).pins.add("sum", Pin("chain", "now", {"sum": str(pinned.ended["sum"].key)}))
    chain.run("factor=3")
    collected(chain, keep_last=1)
    assert is_cached(chain, "factor=2")


def test_a_pin_that_cannot_be_read_stops_everything(chain: Workspace) -> None:
    chain.run("factor=2")
    chain.run("factor=3")
    store = store_of(chain)
    store.folder("pins").joinpath("paper.json").write_text("{")
    with pytest.raises(UserError, match="not a readable pin"):
        collect(store, Rules(keep_last=1))


def test_a_record_that_cannot_be_read_stops_everything(chain: Workspace) -> None:
    """A disk that just does not answer must not cost what the record names."""
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
    collected(chain, keep_last=1, younger_than=1.0)
    assert is_cached(chain, "factor=2")
    collected(chain, keep_last=1)
    assert not is_cached(chain, "factor=2")


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
    store.history.forget("chain")
    collected(chain, keep_last=1)
    assert len(store.actions) == 4


def test_checkpoints_that_may_be_worth_something_stay(chain: Workspace) -> None:
    ran = chain.run()
    store = store_of(chain)
    done, begun, young, old = str(ran.ended["sum"].key), "a" * 64, "b" * 64, "c" * 64
    journal = store.history.begin("chain", whole=True)
    journal.begin(begun)
    journal.close()
    long_ago = time.time() - (CHECKPOINT_DAYS + 1) * 86400
    for key in (done, begun, young, old):
        folder = store.folder("scratch", key)
        (folder / "checkpoint").write_text("half")
        if key != young:
            for path in (folder / "checkpoint", folder):
                os.utime(path, (long_ago, long_ago))
    collection = collected(chain)
    assert sorted(path.name for path in (store.root / "scratch").iterdir()) == [begun, young]
    assert len([remark for remark in collection.remarks if "checkpoint" in remark]) == 2


def test_a_checkpoint_of_a_run_that_no_longer_counts_goes_when_it_is_old(chain: Workspace) -> None:
    store = store_of(chain)
    journal = store.history.begin("chain", whole=True)
    journal.begin("a" * 64)
    journal.close()
    folder = store.folder("scratch", "a" * 64)
    os.utime(folder, (0, 0))
    for factor in (2, 3, 4):
        chain.run(f"factor={factor}")
    collected(chain, keep_last=4)
    assert folder.exists()
    collected(chain, keep_last=3)
    assert not folder.exists()


def test_what_is_damaged_goes_when_it_was_made_again_or_is_not_needed(chain: Workspace) -> None:
    """And no sooner: it may be all that is left of something."""
    chain.run("factor=2")
    twice = chain.run("factor=3").ended["twice"].outputs["numbers"]
    next(twice.glob("arrays.zarr/values/c/*")).write_bytes(b"")
    (twice.parent / twice.name / ".DS_Store").write_text("?")
    store = store_of(chain)
    assert [checked for checked in verify_store(store) if checked.damage]
    needed = collected(chain)
    assert "2 damaged in" in "; ".join(needed.remarks)
    assert {path.name for path in store.root.glob("damaged/objects/*")} == {twice.name}
    chain.run("factor=3")
    assert any("made again" in waste.what for waste in collect(store, Rules()).waste)
    assert collected(chain).remarks
    assert not list(store.root.glob("damaged/*/*"))
    assert is_cached(chain, "factor=3")


def test_leftovers_go(chain: Workspace) -> None:
    chain.run()
    store = store_of(chain)
    (store.root / "temporary" / "of-a-dead-process").mkdir()
    shutil.copytree(store.object(next(iter(store.objects))), store.object("f" * 64))
    store.folder("code").joinpath("0.json").write_text("{}")
    store.folder("logs", "gone").joinpath("a.log").write_text("said")
    collected(chain)
    assert not list((store.root / "temporary").glob("*dead*"))
    assert not (store.root / "code" / "0.json").exists()
    assert not (store.root / "logs" / "gone").exists()
    assert (store.root / "logs" / "chain").exists()
    assert_sound(store)
    assert is_cached(chain)


def test_old_journals_go_but_not_the_last_word_on_a_stage(chain: Workspace) -> None:
    """A stage that failed ever since has its last result far back."""
    text = "name: chain\nstages:\n  late: {uses: %s}\n  base: {uses: numbers}\n"
    chain.write(text % "measure").run()
    chain.write("name: chain\nstages:\n  late: {uses: fail, in: {numbers: base}}\n  base: {uses: numbers}\n")
    for _ in range(JOURNALS_KEPT + 3):
        chain.run()
    history = store_of(chain).history
    first = history.journals("chain")[-1]
    collected(chain, keep_last=1)
    assert len(history.journals("chain")) == JOURNALS_KEPT + 1
    assert history.journals("chain")[-1] == first
    assert is_cached(chain.write(text % "measure"))


def test_a_full_disk_is_made_room_on(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """To move something aside takes a folder and a lock."""
    for factor in (2, 3):
        chain.run(f"factor={factor}")
    store = store_of(chain)

    def full(temporary: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pipeline.store.OwnFolder", full)
    collect(store, Rules(keep_last=1)).delete()
    monkeypatch.undo()
    assert len(store.actions) == 4
    assert_sound(store)
    assert [is_cached(chain, f"factor={factor}") for factor in (2, 3)] == [False, True]


def test_broken_off_on_a_full_disk(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is half deleted is nothing any more: it has lost what makes it whole first."""
    store = chain.run().project.store
    digest = next(iter(store.objects))

    def broken_off(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.disk.remove", broken_off)
    with pytest.raises(KeyboardInterrupt):
        remove_where_it_lies(store.object(digest), "manifest.json")
    assert not store.is_whole(digest)


def test_no_run_may_go_on_meanwhile(chain: Workspace) -> None:
    chain.run()
    store = store_of(chain)
    with store.in_use(), pytest.raises(CommandError, match="runs are using the store"):
        collected(chain)
    with store.in_use(alone=True), pytest.raises(CommandError, match="being deleted"):
        chain.run()


def test_broken_off_at_any_step_the_store_is_valid(chain: Workspace, tmp_path: Path) -> None:
    """Before each step, and within it: what is to be deleted has been moved aside, and is not deleted yet."""
    for factor in (2, 3, 4):
        chain.run(f"factor={factor}")
    original = tmp_path / "original"
    shutil.copytree(store_of(chain).root, original, symlinks=True)
    steps = len(collect(Store(original), Rules(keep_last=1))._steps)
    assert steps > 8
    for number in range(steps):
        root = store_of(chain).root
        shutil.rmtree(root)
        shutil.copytree(original, root, symlinks=True)
        store = Store(root)
        for step in collect(store, Rules(keep_last=1))._steps[:number]:
            step()
        assert_sound(store)
        assert is_cached(chain, "factor=4")
        collected(chain, keep_last=1)
        assert len(store.actions) == 4
        assert_sound(store)


KILLED = """
import os, signal, sys
from pathlib import Path
import pipeline.store
from pipeline.garbage import Rules, collect
left = [int(sys.argv[2])]
def remove(path, real=pipeline.store.remove):
    left[0] -= 1
    if left[0] < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    real(path)
pipeline.store.remove = remove
store = pipeline.store.Store(Path(sys.argv[1]))
with store.in_use(alone=True):
    collect(store, Rules(keep_last=1)).delete()
"""


@pytest.mark.parametrize("number", [0, 3])
def test_killed_while_it_deletes(chain: Workspace, number: int) -> None:
    """What it was deleting lies in `temporary`, and the lock died with the process."""
    for factor in (2, 3, 4):
        chain.run(f"factor={factor}")
    store = store_of(chain)
    killed = subprocess.run([sys.executable, "-c", KILLED, str(store.root), str(number)], cwd=ROOT, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert len(left_behind(store.root / "temporary")) == 1
    assert_sound(store)
    assert is_cached(chain, "factor=4")
    collected(chain, keep_last=1)
    assert not left_behind(store.root / "temporary")
    assert len(store.actions) == 4
