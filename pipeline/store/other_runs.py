"""Detects another run of the same workflow: both write its logs, and its links in `latest`."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import IO

from pipeline.disk import leads_elsewhere
from pipeline.store.store import LOCKS, Store

RUNS = "runs"
MIXED = "logs and `latest` will mix both; when both have ended, repeat this command to correct `latest`"


@contextmanager
def beside_others(store: Store, workflow: str) -> Iterator[bool]:
    """Registers a run of a workflow on this machine, and yields whether there are others.

    Yields False if that cannot be determined, for example on a full disk or one without locks: no run fails for it.
    """
    with ExitStack() as taken:
        others = False
        elsewhere = leads_elsewhere(store.root, LOCKS, RUNS)  # over a link: no file may be created there
        with suppress(OSError):
            if not elsewhere:
                path = store.folder(LOCKS, RUNS) / workflow
                descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
                file = taken.enter_context(os.fdopen(descriptor, "ab"))
                others = not _is_alone(file)
                fcntl.flock(file, fcntl.LOCK_SH)  # shared with later runs, so that each is seen until it ends
        yield others


def _is_alone(file: IO[bytes]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
