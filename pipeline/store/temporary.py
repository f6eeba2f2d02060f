"""What a process is writing: a folder of its own, which a later process removes if this one did not.

temporary/<id>/        nobody else can read it
temporary/<id>.lock    locked by the process that writes; the kernel frees it when that ends, however it ends
"""

from __future__ import annotations

import fcntl
import os
import shutil
import uuid
import weakref
from contextlib import suppress
from pathlib import Path

from pipeline.disk import entries_of

LOCK = ".lock"


class OwnFolder:
    """A folder in `temporary` that belongs to this process, and is removed with this object. Raises OSError if full."""

    def __init__(self, temporary: Path) -> None:
        descriptor = None
        while descriptor is None:
            self.path = temporary / uuid.uuid4().hex
            descriptor = _hold(_lock_of(self.path), wait=True)
        try:
            self.path.mkdir(mode=0o700)
        except OSError:  # a full disk
            _remove(self.path, descriptor)
            raise
        weakref.finalize(self, _give_up, self.path, descriptor, os.getpid())


def sweep(temporary: Path) -> None:
    """Removes what processes that have ended left behind; folders in use, by this process or others, are untouched."""
    entries = entries_of(temporary.parent, temporary.name)
    for name in {entry.name.removesuffix(LOCK) for entry in entries if entry.name != LOCK}:
        with suppress(OSError):  # another user's, or another process sweeps, too
            path = temporary / name
            descriptor = _hold(_lock_of(path), wait=False)
            if descriptor is not None:
                _remove(path, descriptor)


def left_behind(temporary: Path) -> list[Path]:
    """The folders that `sweep` would remove."""
    left = []
    for path in [Path(entry.path) for entry in entries_of(temporary.parent, temporary.name)]:
        if not path.name.endswith(LOCK):
            descriptor = _hold(_lock_of(path), wait=False)
            if descriptor is not None:
                os.close(descriptor)
                left.append(path)
    return left


def _lock_of(path: Path) -> Path:
    return path.with_name(path.name + LOCK)


def _hold(lock: Path, wait: bool) -> int | None:
    """Locks a file, creating it if it is missing; None if another process holds it or has just removed it."""
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), lock.stat()):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


def _give_up(path: Path, descriptor: int, process: int) -> None:
    if os.getpid() == process:  # a forked child shares the lock and owns nothing
        with suppress(OSError):
            _remove(path, descriptor)


def _remove(path: Path, descriptor: int) -> None:
    """Removes a folder and then its lock, which is held until the end, so that no other process removes it, too."""
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        if not os.path.lexists(path):
            _lock_of(path).unlink(missing_ok=True)
    finally:
        os.close(descriptor)
