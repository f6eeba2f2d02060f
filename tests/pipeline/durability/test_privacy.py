"""Nobody else can read what is private, while it is written and afterwards, whatever the user's umask."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import ArtifactWriter
from pipeline.store.record import Record
from pipeline.store.store import Store
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import CHAIN, PROVENANCE, Workspace


@pytest.fixture(params=[0o000, 0o022, 0o077])
def mask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def test_modes(tmp_path: Path, mask: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOLD", str(tmp_path / "told.txt"))
    workspace = Workspace(tmp_path, TOYS).write("name: modes\nstages:\n  a: {uses: spread}\n")
    ran = workspace.run()
    meanwhile = json.loads((tmp_path / "told.txt").read_text())
    assert len(meanwhile) > 8
    for path, found in meanwhile.items():
        assert int(found, 8) & 0o077 == 0, f"{path} was {found} while it was written"
    hidden, shown = (ran.ended["a"].outputs[name] for name in ("hidden", "shown"))
    store = tmp_path / "store"
    private = [
        *(hidden, *hidden.rglob("*")),
        store / "latest/modes",
        *(store / "runs", *(store / "runs").rglob("*")),
        *(store / "logs/modes/private", store / "logs/modes/private/a.log"),
        *(store / "actions" / str(ran.ended["a"].key)).rglob("*"),
        *(store / "cache/declarations").glob("*"),
    ]
    for path in private:
        assert mode(path) == (0o700 if path.is_dir() else 0o600), path
    for path in (shown, *shown.rglob("*")):
        assert mode(path) == (0o777 if path.is_dir() else 0o666) & ~mask, path
    assert os.umask(mask) == mask, "the mask is the user's again"


def test_links_of_an_earlier_version_are_closed_to_others(workspace: Workspace) -> None:
    """The names of stages may reveal messages."""
    latest = workspace.write(CHAIN).run().project.store.root / "latest/chain"
    latest.chmod(0o755)
    assert set(workspace.run().states.values()) == {"cached"}
    assert mode(latest) == 0o700


@pytest.mark.parametrize("private", ["action", "output"])
def test_a_record_tells_of_what_was_private(tmp_path: Path, private: str) -> None:
    """The record is also private if all outputs are public: its parameters may be private, for example."""
    store = Store(tmp_path / "store")
    writer = ArtifactWriter(store.temporary() / "out", "numbers", private=private == "output")
    writer.write("values", np.zeros(3))
    store.commit("ab" * 32, {}, {"out": writer}, {**PROVENANCE, "private": private == "action"})
    folder = store.root / "actions" / ("ab" * 32)
    assert (mode(folder), mode(folder / "record.json")) == (0o700, 0o600)


def test_a_record_that_was_accepted_tells_of_what_was_private(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.add(Record("ab" * 32, {}, {}, {**PROVENANCE, "private": True}))
    folder = store.root / "actions" / ("ab" * 32)
    assert (mode(folder), mode(folder / "record.json")) == (0o700, 0o600)
