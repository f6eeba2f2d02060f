"""A power cut at any moment: nothing gets its name before it is on the disk, and a failing disk fails the stage."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.store.store import Store
from tests.pipeline.helpers import CHAIN, Workspace


class Recorder:
    """What was flushed, with its modification time then, and what was renamed to where, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, store: Path) -> None:
        self.store = store
        self.flushed: dict[str, int] = {}
        self.order: list[tuple[str, str]] = []
        self.unflushed: list[str] = []
        fsync, rename = os.fsync, os.rename

        def recorded_fsync(descriptor: int) -> None:
            fsync(descriptor)
            path = str(Path(f"/proc/self/fd/{descriptor}").readlink())
            self.flushed[path] = os.fstat(descriptor).st_mtime_ns
            self.order.append(("flush", path))

        def recorded_rename(source: Path, target: Path) -> None:
            if target.parent.name in ("objects", "actions"):
                for path in (source, *source.rglob("*")):
                    if self.flushed.get(str(path)) != path.stat().st_mtime_ns:
                        self.unflushed.append(str(path))
                self.order.append((target.parent.name, str(target)))
            rename(source, target)

        monkeypatch.setattr(os, "fsync", recorded_fsync)
        monkeypatch.setattr(os, "rename", recorded_rename)


def test_nothing_is_renamed_before_it_is_flushed(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """First files and folders, then the name, then the folder of names; objects before the record that names them."""
    store = workspace.folder / "store"
    recorder = Recorder(monkeypatch, store)
    workspace.write(CHAIN).run()
    assert recorder.unflushed == []
    names = [(what, path) for what, path in recorder.order if what != "flush"]
    assert len([what for what, _ in names if what == "actions"]) == 4
    for index, (what, path) in enumerate(recorder.order):
        if what == "flush":
            continue
        following = recorder.order[index + 1 :]
        flush = following.index(("flush", str(store / what)))
        assert all(other == "flush" for other, _ in following[:flush]), f"{path}: its name is flushed before the next"
    for folder in ("objects", "actions"):
        first = next(index for index, (what, _) in enumerate(recorder.order) if what == folder)
        assert ("flush", str(store)) in recorder.order[:first], f"the name {folder} itself"


def test_a_disk_that_cannot_flush_fails_the_stage(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever flush fails, the stage fails, and the next run makes the result."""
    workspace.write("stages:\n  base: {uses: numbers}\n  twice: {uses: scale, in: {numbers: base}}\n")
    workspace.run(stages=["base"])
    fsync = os.fsync
    number, failing = 0, True
    while failing:
        number += 1
        count = 0

        def fails(descriptor: int, number: int = number) -> None:
            nonlocal count
            count += 1
            if count == number:
                raise OSError(5, "Input/output error")
            fsync(descriptor)

        monkeypatch.setattr(os, "fsync", fails)
        ran = workspace.run(f"twice.factor={number}")
        failing = count >= number
        monkeypatch.setattr(os, "fsync", fsync)
        if failing:
            assert ran.states == {"base": "cached", "twice": "failed"}
            assert "Input/output error" in str(ran.ended["twice"].cause)
        assert workspace.run(f"twice.factor={number}").summary.counts.get("failed", 0) == 0
    assert number > 8, "files, folders, names"
    store = Store(workspace.folder / "store")
    assert all(store.find(key) for key in store.actions)
