"""A store that does not exist yet, as seen by commands that only read: empty, and not created by reading."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.store.store import Store


class AbsentStore(Store):
    """A store whose folder is missing or empty, and which is never created.

    Data that is only cached for the next run is dropped: the code that writes it tolerates a failed write.
    """

    def folder(self, *names: str) -> Path:
        """Always raises OSError: there is no folder to write to."""
        raise OSError(errno.ENOENT, "no store there yet", str(self.root))

    @contextmanager
    def in_use(self, alone: bool = False) -> Iterator[None]:
        """Takes no lock: there is nothing that another process could delete."""
        yield
