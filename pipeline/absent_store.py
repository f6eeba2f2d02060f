"""A store that is not there yet, as a command sees it that only reads: nothing is in it, and nothing is made there."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.store import Store


class AbsentStore(Store):
    """A store in a folder that is missing or empty, and stays so.

    What would be remembered for the next time is forgotten: whoever writes into a store can do without.
    """

    def folder(self, *names: str) -> Path:
        """Raises OSError: there is no folder to write into."""
        raise OSError(errno.ENOENT, "no store there yet", str(self.root))

    @contextmanager
    def in_use(self, alone: bool = False) -> Iterator[None]:
        """Holds nothing: there is nothing that anybody could delete."""
        yield
