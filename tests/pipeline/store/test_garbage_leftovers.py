"""`gc`: checkpoints, damaged data, journals and other leftovers go once they are of no use."""

from __future__ import annotations

import os
import shutil
import time

import pytest

from pipeline.store.garbage import CACHE_DAYS, CHECKPOINT_DAYS, JOURNALS_KEPT, Rules, collect
from pipeline.store.verification import verify_store
from tests.pipeline.collecting import assert_sound, collected, is_cached, store_of
from tests.pipeline.helpers import CHAIN, Workspace


@pytest.fixture
def chain(workspace: Workspace) -> Workspace:
    return workspace.write(CHAIN)


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
        if key in (begun, old):
            for path in (folder / "checkpoint", folder):
                os.utime(path, (long_ago, long_ago))
    collection = collected(chain)
    assert sorted(path.name for path in (store.root / "scratch").iterdir()) == [begun, young]
    assert len([remark for remark in collection.remarks if "checkpoint" in remark]) == 2


def test_checkpoints_of_unfinished_work_stay_for_two_weeks(chain: Workspace) -> None:
    """As the help of `gc` says, so that work can resume after a holiday."""
    store = store_of(chain)
    for name, days in (("a", 13), ("b", 15)):
        folder, then = store.folder("scratch", name * 64), time.time() - days * 86400
        (folder / "checkpoint").write_text("half")
        for path in (folder / "checkpoint", folder):
            os.utime(path, (then, then))
    said = "checkpoint aaaaaaaa: unfinished work, 13 days old; deleted after 14 days"
    assert said in collected(chain).remarks
    assert [path.name for path in (store.root / "scratch").iterdir()] == ["a" * 64]


def test_a_checkpoint_of_a_run_that_no_longer_counts_goes_when_it_is_old(chain: Workspace) -> None:
    store = store_of(chain)
    journal = store.history.begin("chain", whole=True)
    journal.begin("a" * 64)
    journal.close()
    folder = store.folder("scratch", "a" * 64)
    (folder / "checkpoint").write_text("half")
    for path in (folder / "checkpoint", folder):
        os.utime(path, (0, 0))
    for factor in (2, 3, 4):
        chain.run(f"factor={factor}")
    collected(chain, keep_last=4)
    assert folder.exists()
    collected(chain, keep_last=3)
    assert not folder.exists()


def test_a_checkpoint_of_what_is_being_made_again_stays(chain: Workspace) -> None:
    """The record of a damaged artifact is still there."""
    ran = chain.run()
    store = store_of(chain)
    folder = store.folder("scratch", str(ran.ended["twice"].key))
    (folder / "checkpoint").write_text("half")
    made = ran.ended["twice"].outputs["numbers"]
    next(made.glob("arrays.zarr/values/c/*")).write_bytes(b"")
    store.set_aside(made.name)
    collected(chain)
    assert (folder / "checkpoint").exists()
    chain.run()
    collected(chain)
    assert not folder.exists()


def test_a_folder_with_nothing_in_it_is_no_checkpoint(workspace: Workspace) -> None:
    """Every stage gets one, and it stays empty if the stage fails or is interrupted before it saves anything."""
    workspace.write("stages:\n  base: {uses: numbers}\n  bad: {uses: fail, in: {numbers: base}}\n").run()
    store = store_of(workspace)
    (left,) = (store.root / "scratch").iterdir()
    store.folder("scratch", "b" * 64).joinpath("checkpoint").write_text("half")
    collection = collected(workspace)
    assert [waste.number for waste in collection.waste if "left no checkpoint" in waste.what] == [1]
    (remark,) = [remark for remark in collection.remarks if "checkpoint" in remark]
    assert remark.startswith("checkpoint bbbbbbbb: unfinished work")
    assert not left.exists()
    assert (store.root / "scratch" / ("b" * 64)).is_dir()
    assert not collected(workspace).waste


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


def test_what_is_damaged_stays_if_its_record_is_damaged_too(chain: Workspace) -> None:
    """Nobody can tell what that record needs."""
    twice = chain.run().ended["twice"]
    artifact, store = twice.outputs["numbers"], store_of(chain)
    next(artifact.glob("arrays.zarr/values/c/*")).write_bytes(b"")
    assert [checked for checked in verify_store(store) if checked.damage]
    (store.damaged.folder / "actions" / str(twice.key) / "record.json").write_bytes(b"")
    collected(chain)
    assert (store.damaged.folder / "objects" / artifact.name).is_dir()


def test_leftovers_go(chain: Workspace) -> None:
    chain.run()
    store = store_of(chain)
    (store.root / "temporary" / "of-a-dead-process").mkdir()
    shutil.copytree(store.object(next(iter(store.objects))), store.object("f" * 64))
    store.folder("code").joinpath("0.json").write_text("{}")
    store.folder("logs", "gone").joinpath("a.log").write_text("said")
    collected(chain)
    assert not list((store.root / "temporary").glob("of-a-dead-process*"))  # a name drawn at random may contain "dead"
    assert not (store.root / "code" / "0.json").exists()
    assert not (store.root / "logs" / "gone").exists()
    assert (store.root / "logs" / "chain").exists()
    assert_sound(store)
    assert is_cached(chain)


def test_names_of_files_go_with_what_was_made_from_them(workspace: Workspace) -> None:
    """A plan that reads a file again records its name again."""
    file, text = workspace.folder / "message.txt", "name: of_file\nstages:\n  base: {uses: numbers, with: {file: %s}}\n"
    listings = workspace.folder / "store" / "external"
    for number in (1, 2):
        file.write_text(f"{number}\n")
        workspace.write(text % file).run()
    workspace.write("name: other\nstages:\n  base: {uses: numbers}\n").run()
    assert len(list(listings.iterdir())) == 2
    collected(workspace, keep_last=1)
    (of_file,) = {name for record in store_of(workspace).records() for name in record.external.get("file", ())}
    assert [path.stem for path in listings.iterdir()] == [of_file]
    collected(workspace, forgotten=frozenset({"of_file"}))
    assert not list(listings.iterdir())
    assert workspace.write(text % file).plan()["base"].state == "run"
    assert [path.stem for path in listings.iterdir()] == [of_file]


def test_what_can_be_computed_again_goes_when_it_is_of_no_use(workspace: Workspace) -> None:
    """The later of two times tells when it was last used: not every disk notes when a file is read."""
    store = store_of(workspace)
    lately, long_ago = (time.time() - days * 86400 for days in (CACHE_DAYS - 1, CACHE_DAYS + 1))
    kinds, times = {"declarations", "external", "sources"}, {"used": (lately, long_ago), "new": (long_ago, lately)}
    for kind in kinds:
        for name, read_and_written in {**times, "old": (long_ago, long_ago)}.items():
            file = store.folder("cache", kind) / f"{name}.json"
            file.touch()
            os.utime(file, read_and_written)
    collected(workspace)
    left = {f"{path.parent.name}/{path.stem}" for path in store.root.glob("cache/*/*")}
    assert left == {f"{kind}/{name}" for kind in kinds for name in times}


def test_what_is_remembered_of_files_goes_with_a_forgotten_workflow(chain: Workspace) -> None:
    """Names of files may reveal a message."""
    chain.run()
    store = store_of(chain)
    store.folder("cache", "external").joinpath("of-a-folder.json").write_text("{}")
    collected(chain)
    assert list(store.root.glob("cache/external/*"))
    collected(chain, forgotten=frozenset({"chain"}))
    assert not list(store.root.glob("cache/external/*"))
    assert not list(store.root.glob("cache/declarations/*"))


def test_old_journals_go_but_not_the_last_word_on_a_stage(chain: Workspace) -> None:
    """The last result of a stage that has failed ever since is far back."""
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
