"""The locks of a store.

All processes that work with results share one lock, which a process that deletes results holds alone. Of the other
locks, those of actions, `is_held` says whether they are held.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import CommandError


@contextmanager
def held(lock: Path, store: Path, alone: bool) -> Iterator[None]:
    """Holds a lock, shared or `alone`; its file is created if it is missing.

    Raises CommandError if the lock cannot be had at once, or if files cannot be locked there.
    """
    # A link would make a file elsewhere; and over NFS a shared lock needs a file that is open for reading.
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    with os.fdopen(descriptor, "ab") as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            others = "runs are using the store" if alone else "results are being deleted from the store"
            raise CommandError(others, where=store, remedy="Try again when that has finished.") from None
        except OSError as error:  # such as NFS without its lock manager
            raise CommandError(
                "a file here cannot be locked, so runs could interfere with each other",
                where=store,
                found=error.strerror,
                remedy="Put the store on a disk that supports file locks, with --store or $GS_HIDER_STORE.",
            ) from error
        yield


def is_held(lock: Path) -> bool:
    """Whether a process holds a lock; False if that cannot be determined. Does not create a missing lock."""
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
