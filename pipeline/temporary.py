"""What a process is writing: a folder of its own, which whoever comes later removes if the process did not.

temporary/<id>/        nobody else can read it
temporary/<id>.lock    held by the kernel for the process that writes; free once that has ended, however it did
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
    """A folder in `temporary` that is this process's while this object lives."""

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
    """Removes what processes left that have ended. What lives, in this process or any other, is not touched."""
    for name in {entry.name.removesuffix(LOCK) for entry in entries_of(temporary.parent, temporary.name)}:
        with suppress(OSError):  # of another user, or another process sweeps too
            path = temporary / name
            descriptor = _hold(_lock_of(path), wait=False)
            if descriptor is not None:
                _remove(path, descriptor)


def left_behind(temporary: Path) -> list[Path]:
    """What `sweep` would remove."""
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
    """Locks a file, which is made where it is missing; None where another process holds it or has just removed it."""
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
    """Removes a folder and then its lock, which is held: nobody sees a folder that nobody holds and nobody removes."""
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        if not os.path.lexists(path):
            _lock_of(path).unlink(missing_ok=True)
    finally:
        os.close(descriptor)
