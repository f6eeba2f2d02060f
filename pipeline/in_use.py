"""The locks of a store: one that all who work with results hold together, and who deletes some alone; whether another,
that of an action, is held."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import CommandError


@contextmanager
def held(lock: Path, store: Path, alone: bool) -> Iterator[None]:
    """Holds a lock, which is made where it is missing. Raises CommandError where it cannot be had at once."""
    # A link would make a file elsewhere; and over NFS a lock is shared only by who could read the file.
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    with os.fdopen(descriptor, "ab") as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            others = "runs are using the store" if alone else "results are being deleted from the store"
            raise CommandError(others, where=store, remedy="Try again when that has ended.") from None
        except OSError as error:  # such as NFS without its lock manager
            raise CommandError(
                "a file here cannot be locked, so runs could disturb each other",
                where=store,
                found=error.strerror,
                remedy="Have the store on a disk with file locks, with --store or $GS_HIDER_STORE.",
            ) from error
        yield


def is_held(lock: Path) -> bool:
    """Whether a process holds a lock; False where that cannot be seen. A lock that is missing is not made."""
    try:
        descriptor = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)  # a stranger's may be a pipe
    except OSError:
        return False
    with os.fdopen(descriptor, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return False
