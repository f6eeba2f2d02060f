"""`gc` spares what may be all that is left: beside damaged records, of killed runs, in folders that it cannot see."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.run.runner import Run
from pipeline.store.verification import verify_store
from tests.pipeline.collecting import collected, is_cached, store_of
from tests.pipeline.helpers import CHAIN, Ran, Workspace

KEY = """
    name: hides
    stages:
      key:  {uses: draw}
      hide: {uses: scale, in: {numbers: key}}
    """


def alter(workspace: Workspace, ran: Ran, stage: str) -> None:
    """Flip a bit of a stage's record, and let `verify` set it aside."""
    file = workspace.folder / "store" / "actions" / str(ran.ended[stage].key) / "record.json"
    content = bytearray(file.read_bytes())
    content[content.index(b'"seconds"') + 12] ^= 1
    file.write_bytes(content)
    assert [each.what for each in verify_store(store_of(workspace)) if each.damage] == ["record"]


def test_a_sound_key_outlives_its_damaged_record(workspace: Workspace) -> None:
    """`gc` itself says that `verify` is to be run first, which sets the record aside."""
    ran = workspace.write(KEY).run()
    key = ran.ended["key"].outputs["numbers"]
    alter(workspace, ran, "key")
    assert workspace.run().states["key"] == "failed", "no run draws another"
    for _ in range(2):
        collected(workspace, keep_last=1)
    assert key.is_dir()
    assert store_of(workspace).is_sound(key.name)


def test_what_was_made_again_frees_what_its_damaged_record_named(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    alter(workspace, ran, "twice")
    assert workspace.run().states["twice"] == "ran"
    collected(workspace, keep_last=1)
    assert is_cached(workspace)
    assert not list((workspace.folder / "store" / "damaged").glob("actions/*"))


def test_the_sound_outputs_beside_a_damaged_one_stay(workspace: Workspace) -> None:
    outputs = workspace.write(CHAIN).run().ended["sum"].outputs
    (outputs["total"] / "manifest.json").write_bytes(b"")
    assert {each.what for each in verify_store(store_of(workspace)) if each.damage} >= {"artifact", "record"}
    collected(workspace)
    assert {name: path.exists() for name, path in outputs.items()} == {name: name != "total" for name in outputs}


def test_what_a_worker_finished_after_its_run_was_killed_stays(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the journal nor a link names it; the journal only says that the run began it."""

    class Killed(BaseException):
        pass

    taken = Run._take

    def take(run: Run, name: str, outcome: object) -> object:
        if name == "twice":
            raise Killed
        return taken(run, name, outcome)  # type: ignore[arg-type]

    workspace.write(CHAIN)
    with monkeypatch.context() as during:
        during.setattr(Run, "_take", take)
        with pytest.raises(Killed):
            workspace.run()
    collected(workspace)
    assert workspace.plan()["twice"].state == "cached"


@pytest.mark.parametrize("folder", ["runs", "runs/chain", "latest/chain", "pins"])
def test_folders_that_cannot_be_listed_stop_everything(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    """Those of another user of the store: what they keep is unknown, not nothing."""
    workspace.write(CHAIN).run()
    hidden = workspace.folder / "store" / folder
    hidden.mkdir(exist_ok=True)
    scan = os.scandir

    def refused(path: str | Path | int) -> object:
        if not isinstance(path, int) and Path(path) == hidden:
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    with monkeypatch.context() as during:
        during.setattr(os, "scandir", refused)
        with pytest.raises(UserError, match=f"{hidden}: a folder of the store cannot be listed"):
            collected(workspace)
    assert is_cached(workspace)
