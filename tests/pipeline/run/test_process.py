"""What a process that runs stages makes for itself, and removes."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from filelock import FileLock

from pipeline.run.process import KernelCache

ROOT = Path(__file__).parents[3]
FORKS = """
import os, sys
from pipeline.run.process import KernelCache
cache = KernelCache()
child = os.fork()
if child == 0:
    sys.exit()
os.waitpid(child, 0)
print(cache.folder, cache.folder.is_dir())
"""


def test_kernels_that_cannot_be_kept_go_with_the_process(tmp_path: Path) -> None:
    """A child that it forked removes nothing."""
    (tmp_path / "file").touch()
    passing = tmp_path / "passing"
    passing.mkdir()
    told = {"POCL_CACHE_DIR": str(tmp_path / "file" / "kernels"), "TMPDIR": str(passing)}
    done = subprocess.run(
        [sys.executable, "-c", FORKS], cwd=ROOT, env={**os.environ, **told}, check=True, capture_output=True, text=True
    )
    folder, there = done.stdout.split()
    assert (Path(folder).is_relative_to(passing), there) == (True, "True")
    assert not list(passing.iterdir())


def test_a_home_without_room_or_locks_is_no_reason_to_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It can be made and written to, but that does not mean that files in it can be locked."""
    (tmp_path / "home").mkdir()
    (tmp_path / "passing").mkdir()
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "passing"))
    acquire = FileLock.acquire

    def over_nfs(lock: FileLock) -> object:
        if Path(lock.lock_file).is_relative_to(tmp_path / "home"):
            raise OSError(errno.ENOLCK, "No locks available")
        return acquire(lock)

    monkeypatch.setattr(FileLock, "acquire", over_nfs)
    cache = KernelCache()
    try:
        assert cache.folder.is_relative_to(tmp_path / "passing")
        assert os.environ["POCL_CACHE_DIR"] == str(cache.folder)
    finally:
        cache.release()


@pytest.mark.parametrize("before", [None, "kernels"])
def test_a_folder_that_was_given_back_is_named_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    """Whoever compiles next in this process would share the folder above it with others."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    wished = None if before is None else str(tmp_path / before)
    if wished is not None:
        monkeypatch.setenv("POCL_CACHE_DIR", wished)
    cache = KernelCache()
    assert os.environ["POCL_CACHE_DIR"] == str(cache.folder)
    cache.release()
    assert os.environ.get("POCL_CACHE_DIR") == wished
