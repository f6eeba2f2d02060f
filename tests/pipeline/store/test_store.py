"""The store: two writers, damage, and what git ignores."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import ArtifactWriter
from pipeline.store.record import Record, first_makers, newest_makers
from pipeline.store.store import Store
from tests.pipeline.helpers import CHAIN, PROVENANCE, Workspace

KEY = "ab" * 32


def commit(store: Store, value: float, key: str = KEY) -> Record:
    writer = ArtifactWriter(store.temporary() / "out", "numbers")
    writer.write("values", np.full(3, value))
    return store.commit(key, {"a": 1}, {"out": writer}, PROVENANCE)


def test_the_first_of_two_results_stays(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    first = commit(store, 1.0)
    second = commit(store, 2.0)
    assert second == first == store.find(KEY)


def test_one_object_for_equal_results(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    outputs = commit(store, 1.0).outputs
    place = store.object(outputs["out"])
    first = place.stat().st_ino
    assert commit(store, 1.0, "cd" * 32).outputs == outputs
    store.set_aside(outputs["out"])
    assert list((store.root / "objects").iterdir()) == [place]
    assert place.stat().st_ino == first, "a sound one stays: others may be reading it"


def test_a_damaged_object_is_replaced(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    digest = commit(store, 1.0).outputs["out"]
    chunk = next(path for path in store.object(digest).glob("arrays.zarr/values/c/*"))
    chunk.write_bytes(b"")
    commit(store, 1.0, "cd" * 32)
    np.testing.assert_array_equal(store.artifact(digest).read("values"), np.ones(3))


def test_what_is_damaged_is_moved_under_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a whole one that another process has just put there could be moved."""
    store = Store(tmp_path / "store")
    digest = commit(store, 1.0).outputs["out"]
    clear, locked = Store._clear_damaged, []

    def watched(store: Store, digest: str) -> None:
        locked.append(store.is_locked(digest))
        clear(store, digest)

    monkeypatch.setattr(Store, "_clear_damaged", watched)
    store.set_aside(digest)
    commit(store, 1.0, "cd" * 32)
    assert locked == [True, True]


@pytest.mark.parametrize("keys", [("ab" * 32, "cd" * 32), ("cd" * 32, "ab" * 32)])
def test_what_was_accepted_was_made_later(keys: tuple[str, str]) -> None:
    """It has the start time of the result that it was accepted for, and either key may come first."""
    outputs = {"out": "0" * 64}
    made = Record(keys[0], {}, outputs, PROVENANCE)
    accepted = Record(keys[1], {}, outputs, {**PROVENANCE, "accepted": [{"when": "", "changes": []}]})
    records = sorted((made, accepted), key=lambda record: record.key)
    assert first_makers(records) == {"0" * 64: made}
    assert newest_makers(records) == {"0" * 64: accepted}


@pytest.mark.parametrize("damage", ["", "{", "[]", "{}"])
def test_a_damaged_record_is_none(tmp_path: Path, damage: str) -> None:
    store = Store(tmp_path / "store")
    first = commit(store, 1.0)
    (store.root / "actions" / KEY / "record.json").write_text(damage)
    assert store.find(KEY) is None
    assert commit(store, 1.0) == first
    assert store.find(KEY) == first


def test_work_goes_on_if_somebody_removes_what_is_temporary(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.temporary()
    shutil.rmtree(store.root / "temporary")
    store.temporary().write_text("in a new folder")


def test_git_passes_over_a_store(workspace: Workspace) -> None:
    """Also a store of an earlier version in a work tree; what a user writes into its .gitignore stays."""
    git = ["git", "-C", str(workspace.folder)]
    subprocess.run([*git, "init", "-q"], check=True)
    store = workspace.write(CHAIN).run().project.store
    for _ in range(2):
        subprocess.run([*git, "add", "--all"], check=True)
        listed = subprocess.run([*git, "ls-files"], check=True, capture_output=True, text=True).stdout
        assert "workflow.yaml" in listed
        assert "store/" not in listed
        (store.root / ".gitignore").unlink()
        assert set(workspace.run().states.values()) == {"cached"}
    (store.root / ".gitignore").write_text("!latest\n")
    workspace.run()
    assert (store.root / ".gitignore").read_text() == "!latest\n"


def test_what_git_passes_over_is_no_folder_of_something_else(workspace: Workspace) -> None:
    """That is all that `rm -r store/*` leaves."""
    store = workspace.write(CHAIN).run().project.store
    for path in store.root.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
    assert set(workspace.run().states.values()) == {"ran"}
