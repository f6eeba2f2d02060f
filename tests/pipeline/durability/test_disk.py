"""Disks that are full or cannot be written to: one clear line, nothing corrupt, and a run that can resume later."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.disk import words_of
from pipeline.store.store import Store
from tests.pipeline.durability import small_disk
from tests.pipeline.durability.commands import ROOT, TOYS
from tests.pipeline.helpers import CHAIN, Workspace


def may_mount() -> bool:
    return shutil.which("unshare") is not None and subprocess.run(["unshare", "-Urm", "true"]).returncode == 0


@pytest.mark.skipif(not may_mount(), reason="no name spaces for users here")
@pytest.mark.parametrize("flags", ["--serial", pytest.param("--workers=1", marks=pytest.mark.slow)])
def test_small_and_read_only_disks(tmp_path: Path, flags: str) -> None:
    done = subprocess.run(
        ["unshare", "-Urm", sys.executable, "-m", small_disk.__name__, str(tmp_path), flags],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = {line["name"]: line for line in map(json.loads, done.stdout.splitlines())}
    assert not [name for name, line in said.items() if "Traceback" in line["printed"]]
    statuses = {name: line["status"] for name, line in said.items()}
    full = {"large: full", "checkpoint: full", "before: full"}
    unwritten = {f"read-only: to {what}" for what in ("run", "take", "pin", "gc", "unpin")}
    failing = full | unwritten | {"read-only: damaged"}
    assert {name for name, status in statuses.items() if status == 1} - {"log: full"} == failing
    assert set(statuses.values()) == {0, 1}
    for name in full:
        assert "no space left on the disk that holds" in said[name]["printed"], said[name]
    for name in unwritten:
        store = tmp_path / "read-only/store"
        assert said[name]["printed"].startswith(f"{store}: the store cannot be written; found a read-only file system.")
        assert len(said[name]["printed"].splitlines()) == 1, said[name]
    assert said["read-only: verify"]["printed"].startswith("Everything is sound")
    assert "nothing was changed" in said["read-only: damaged"]["printed"]
    assert "1 cached" in said["read-only: status"]["printed"]


@pytest.mark.parametrize(
    ("files", "left", "said"),
    [(1000, 0, "no free inodes"), (1000, 5, "4.1 MB free"), (0, 0, "4.1 MB free")],
    ids=["used up", "some left", "not numbered"],
)
def test_what_is_used_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: int, left: int, said: str) -> None:
    """If inodes are used up, deleting large files does not help."""
    state = os.statvfs_result((4096, 4096, 10**6, 1000, 1000, files, left, left, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda path: state)
    words = words_of(OSError(errno.ENOSPC, "No space left on device"), tmp_path)
    assert said in words
    assert ("inodes" in words) == (said == "no free inodes")


def test_of_a_store_in_a_bucket_it_is_the_disk_of_the_copies() -> None:
    words = words_of(OSError(errno.ENOSPC, "No space left on device"), "s3://bucket/prefix")
    assert words.startswith("no space left on this machine's disk, which holds copies of what is in s3://bucket/prefix")


def room_of(free: int) -> os.statvfs_result:
    return os.statvfs_result((1, 1, 10**13, free, free, 0, 0, 0, 0, 255))


def test_a_full_disk_is_the_one_of_the_file_that_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = {tmp_path / "store": room_of(5 * 10**9), tmp_path: room_of(1000)}
    monkeypatch.setattr(os, "statvfs", rooms.__getitem__)
    (tmp_path / "store").mkdir()
    there = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "stick/copy"))
    assert words_of(there, tmp_path / "store") == (
        f"no space left on the disk that holds {tmp_path}/stick/copy: 1.0 kB free. Make room there, then run again."
    )
    inside = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "store/objects/file"))
    assert words_of(inside, tmp_path / "store").startswith(
        f"no space left on the disk that holds {tmp_path}/store: 5.0 GB free. Completed work"
    )


@pytest.mark.parametrize(("error", "blamed"), [(errno.ENOSPC, False), (errno.EDQUOT, True)])
def test_a_disk_with_much_room_is_hardly_the_full_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, blamed: bool
) -> None:
    """A quota may be used up although the disk has room."""
    monkeypatch.setattr(os, "statvfs", lambda path: room_of(48 * 10**10))
    words = words_of(OSError(error, "No space left on device"), tmp_path)
    assert words.startswith("no space left on the disk that holds") == blamed
    assert ("probably not the one" in words, "480.0 GB free" in words) == (not blamed, True)


@pytest.mark.parametrize(
    ("error", "strerror", "found"),
    [
        (errno.EROFS, "Read-only file system", "a read-only file system"),
        (errno.EACCES, "Permission denied", "no permission for you to write there"),
    ],
)
def test_a_store_that_is_read_only_is_told_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, strerror: str, found: str
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write anywhere
    words = words_of(OSError(error, strerror, str(tmp_path / "store/locks/x")), tmp_path / "store")
    assert words.startswith(f"{tmp_path / 'store'}: the store cannot be written; found {found}. Make")
    assert "--store" in words
    elsewhere = OSError(error, strerror, str(tmp_path / "stick/copy"))
    assert words_of(elsewhere, tmp_path / "store") == f"{tmp_path}/stick/copy: {strerror}"


def test_a_secret_that_cannot_be_read_does_not_make_the_store_unwritable(tmp_path: Path) -> None:
    secret = OSError(errno.EACCES, "Permission denied", str(tmp_path / "objects/x"))
    assert words_of(secret, tmp_path) == f"{tmp_path}/objects/x: Permission denied"
    assert words_of(OSError(errno.EACCES, "Permission denied"), tmp_path) == "Permission denied"


def test_verify_moves_nothing_in_a_store_of_someone_else(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace.write(CHAIN).run()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(Store, "in_use", lambda *_: pytest.fail("a lock there cannot be held"))
    result = CliRunner().invoke(app, ["verify", "--store", str(workspace.folder / "store")])
    assert (result.exit_code, result.output.startswith("Everything is sound")) == (0, True)


def test_a_limit_of_the_size_of_files_is_told_with_what_sets_it(workspace: Workspace) -> None:
    """A shell may have such a limit without anyone having thought of it."""
    workspace.package = TOYS
    workspace.write("name: disk\nstages:\n  large: {uses: grow, with: {steps: 2, size: 60000, seed: 2}}\n")
    command = [sys.executable, "-m", "pipeline", "run", str(workspace.file), "--serial", "--stages", TOYS]
    limited = ["bash", "-c", 'ulimit -f 100; exec "$@"', "bash", *command, "--store", str(workspace.folder / "store")]
    done = subprocess.run(limited, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert "a file is larger than this process may write; found a limit of 102.4 kB a file" in done.stderr
    assert "Raise it, for example with `ulimit -f unlimited`" in done.stderr
    assert "Errno" not in done.stderr


def test_a_disk_that_takes_no_large_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda which: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    words = words_of(OSError(errno.EFBIG, "File too large", str(tmp_path / "stick/copy")), tmp_path)
    assert words.startswith(f"{tmp_path}/stick/copy: a file is larger than its disk allows. Use a disk")
