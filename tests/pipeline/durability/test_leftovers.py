"""What killed processes were writing is removed by the next run; what living processes are writing is not."""

from __future__ import annotations

import fcntl
import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import ArtifactWriter
from pipeline.store.history import History, StageResult
from pipeline.store.store import Store
from pipeline.store.temporary import OwnFolder, sweep
from tests.pipeline.durability.commands import ROOT
from tests.pipeline.helpers import CHAIN, PROVENANCE, Workspace

WRITES = """
import os, signal, sys
from pathlib import Path
from pipeline.store.store import Store
store = Store(Path(sys.argv[1]))
path = store.temporary()
path.mkdir()
(path / "half").write_text("half")
print(path, flush=True)
if sys.argv[2] == "dies":
    os.kill(os.getpid(), signal.SIGKILL)
sys.stdin.read()
"""


def writer(store: Path, what: str) -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES, str(store), what], cwd=ROOT, stdin=-1, stdout=-1, text=True
    )
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_only_what_the_dead_wrote_is_removed(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    mine = store.temporary()
    mine.write_text("mine")
    dead, left = writer(store.root, "dies")
    dead.communicate()
    living, others = writer(store.root, "lives")
    (store.root / "temporary/of an older version").mkdir()
    Store(store.root).sweep()
    assert mine.read_text() == "mine"
    assert (others / "half").exists()
    assert not left.parent.exists()
    living.communicate("")
    assert not others.parent.exists(), "a process that ends by itself removes what it wrote"
    names = {path.name for path in store.root.glob("temporary/*")}
    assert names == {mine.parent.name, f"{mine.parent.name}.lock"}


def test_a_forked_child_removes_nothing_of_its_parents(tmp_path: Path) -> None:
    """It has a copy of the store, and shares the lock."""
    store = Store(tmp_path / "store")
    mine = store.temporary()
    mine.write_text("mine")
    child = os.fork()
    if child == 0:
        del store
        gc.collect()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert mine.read_text() == "mine"


def test_a_lock_that_another_process_has_just_removed_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who sweeps finds a lock before it is held, and removes it: then nobody else would see that it is held."""
    temporary, locked, removed = tmp_path / "temporary", fcntl.flock, []
    temporary.mkdir()

    def removed_then_locked(descriptor: int, how: int) -> None:
        if not removed:
            removed.append(Path(f"/proc/self/fd/{descriptor}").readlink())
            removed[0].unlink()
        locked(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", removed_then_locked)
    own = OwnFolder(temporary)
    sweep(temporary)
    assert removed
    assert own.path.is_dir()


def test_checkpoints_of_finished_actions_are_removed(workspace: Workspace) -> None:
    """A process killed between its commit and its end leaves them; those of unfinished actions stay."""
    ran = workspace.write(CHAIN).run()
    finished = workspace.folder / "store/scratch" / str(ran.ended["base"].key)
    unfinished = workspace.folder / "store/scratch" / ("0" * 64)
    for path in (finished, unfinished):
        path.mkdir()
        (path / "checkpoint").write_text("half")
    workspace.run()
    assert not finished.exists()
    assert unfinished.exists()


def test_a_sound_artifact_is_not_set_aside(tmp_path: Path) -> None:
    """Another run may meanwhile have made it again."""
    store = Store(tmp_path / "store")
    output = ArtifactWriter(store.temporary() / "out", "numbers")
    output.write("values", np.zeros(3))
    digest = store.commit("ab" * 32, {}, {"out": output}, PROVENANCE).outputs["out"]
    store.set_aside(digest)
    assert store.is_sound(digest)
    (store.object(digest) / "arrays.zarr/values/c/0").write_bytes(b"")
    store.set_aside(digest)
    assert not store.object(digest).exists()


def test_an_artifact_in_the_place_of_another_is_damage(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    twice, other = (ran.ended[name].outputs["numbers"] for name in ("twice", "other"))
    for path in twice.rglob("*"):
        if path.is_file():
            path.write_bytes((other / path.relative_to(twice)).read_bytes())
    again = workspace.run()
    assert again.states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "cached"}
    np.testing.assert_array_equal(again.values("twice"), [0.0, 2.0, 4.0])


def test_a_changed_default_in_the_cache_is_not_believed(workspace: Workspace) -> None:
    """It would store a result under the key of other parameters: a wrong result later."""
    text = "stages:\n  base: {uses: numbers}\n  twice: {uses: scale, in: {numbers: base}}\n"
    workspace.write(text).open()
    for path in workspace.folder.glob("store/cache/declarations/*.json"):
        path.write_text(path.read_text().replace("2.0", "3.0"))
    np.testing.assert_array_equal(workspace.run().values("twice"), [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(workspace.run("twice.factor=3.0").values("twice"), [0.0, 3.0, 6.0])


def test_a_journal_goes_on_after_a_line_that_was_cut_off(tmp_path: Path) -> None:
    history = History(tmp_path / "runs")
    journal = history.begin("w")
    journal.add(StageResult("a", "failed", cause="before"))
    with journal.path.open("ab") as file:
        file.write(b'{"name": "b", "sta')
    journal._unfinished = True
    journal.add(StageResult("c", "failed", cause="after"))
    journal.close()
    assert list(history.results(journal.path)) == ["a", "c"]
