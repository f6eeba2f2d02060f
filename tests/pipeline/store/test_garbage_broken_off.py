"""`gc`: wherever it breaks off, and on a full disk, the store stays valid."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest

from pipeline.disk import remove_where_it_lies
from pipeline.errors import CommandError
from pipeline.store.garbage import Rules, collect
from pipeline.store.store import Store
from pipeline.store.temporary import left_behind
from tests.pipeline.collecting import assert_sound, collected, is_cached, store_of
from tests.pipeline.helpers import CHAIN, Workspace

ROOT = Path(__file__).parents[3]


@pytest.fixture
def chain(workspace: Workspace) -> Workspace:
    return workspace.write(CHAIN)


def test_a_full_disk_is_made_room_on(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moving something aside would take a folder and a lock, for which there is no room."""
    for factor in (2, 3):
        chain.run(f"factor={factor}")
    store = store_of(chain)

    def full(temporary: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pipeline.store.store.OwnFolder", full)
    collect(store, Rules(keep_last=1)).delete()
    monkeypatch.undo()
    assert len(store.actions) == 4
    assert_sound(store)
    assert [is_cached(chain, f"factor={factor}") for factor in (2, 3)] == [False, True]


def test_broken_off_on_a_full_disk(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A half-deleted artifact no longer counts: its manifest goes first."""
    store = chain.run().project.store
    digest = next(iter(store.objects))

    def broken_off(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.disk.remove", broken_off)
    with pytest.raises(KeyboardInterrupt):
        remove_where_it_lies(store.object(digest), "manifest.json")
    assert not store.is_whole(digest)


def test_a_lock_is_shared_by_who_may_read_it(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """NFS locks byte ranges, not files: a shared lock needs a readable descriptor, an exclusive one a writable one."""
    store, flock = store_of(chain), fcntl.flock

    def over_nfs(file: IO[bytes], operation: int) -> None:
        access = fcntl.fcntl(file, fcntl.F_GETFL) & os.O_ACCMODE
        needed = os.O_RDONLY if operation & fcntl.LOCK_SH else os.O_WRONLY
        if access not in (needed, os.O_RDWR):
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", over_nfs)
    for alone in (False, True):
        with store.in_use(alone=alone):
            pass


def test_no_run_may_go_on_meanwhile(chain: Workspace) -> None:
    chain.run()
    store = store_of(chain)
    with store.in_use(), pytest.raises(CommandError, match="runs are using the store"):
        collected(chain)
    with store.in_use(alone=True), pytest.raises(CommandError, match="being deleted"):
        chain.run()


def test_broken_off_at_any_step_the_store_is_valid(chain: Workspace, tmp_path: Path) -> None:
    """Broken off before each step in turn; the next collection does the rest."""
    rules = {"keep_last": 1, "forgotten": frozenset({"gone"})}
    chain.write("name: gone\nstages:\n  alone: {uses: numbers, with: {first: 7}}\n").run()
    chain.write(CHAIN)
    for factor in (2, 3, 4):
        chain.run(f"factor={factor}")
    original = tmp_path / "original"
    shutil.copytree(store_of(chain).root, original, symlinks=True)
    steps = len(collect(Store(original), Rules(**rules))._steps)
    assert steps > 8
    for number in range(steps):
        root = store_of(chain).root
        shutil.rmtree(root)
        shutil.copytree(original, root, symlinks=True)
        store = Store(root)
        for step in collect(store, Rules(**rules))._steps[:number]:
            step()
        assert_sound(store)
        assert is_cached(chain, "factor=4")
        collected(chain, **rules)
        assert len(store.actions) == 4
        assert_sound(store)


KILLED = """
import os, signal, sys
from pathlib import Path
import pipeline.store.store
from pipeline.store.garbage import Rules, collect
left = [int(sys.argv[2])]
def remove(path, real=pipeline.store.store.remove):
    left[0] -= 1
    if left[0] < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    real(path)
pipeline.store.store.remove = remove
store = pipeline.store.store.Store(Path(sys.argv[1]))
with store.in_use(alone=True):
    collect(store, Rules(keep_last=1)).delete()
"""


@pytest.mark.parametrize("number", [0, 3])
def test_killed_while_it_deletes(chain: Workspace, number: int) -> None:
    """What it was deleting is in `temporary`, and its lock died with the process."""
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
