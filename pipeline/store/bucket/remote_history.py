"""The history of a store in a bucket: journals written here are put there, and those of other machines fetched.

A bucket has no appending, so the journal of a run is put again and again, at most every few seconds. Other machines do
not see the last seconds of a killed run; the records of its actions they do see.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from pipeline.errors import RemoteError
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.history import History, Journal

PUT_EVERY = 5.0  # seconds
TIMES = 10
"""How often journals are listed again if one disappears before it is fetched."""


class RemoteHistory(History):
    """The runs of the workflows of a store in a bucket; `runs` is the local folder for copies."""

    def __init__(self, runs: Path, bucket: Bucket) -> None:
        super().__init__(runs)
        self._bucket = bucket

    def workflows(self) -> list[str]:
        return sorted({name.split("/")[1] for name in self._bucket.names("runs") if _is_journal(name)})

    def journals(self, workflow: str) -> list[Path]:
        """The files of a workflow's runs, newest first; those that are missing or incomplete here are fetched."""
        for _ in range(TIMES):
            with suppress(FileNotFoundError):  # one was deleted meanwhile, and others are not fetched: list them again
                return self._fetched(workflow)
        raise RemoteError(
            "journals that the bucket lists are not there",
            where=f"{self._bucket.address}/runs/{workflow}",
            remedy="Try again. If this goes on, delete what cannot be read there.",
        )

    def _fetched(self, workflow: str) -> list[Path]:
        """As `journals`. Raises FileNotFoundError if one disappears between being listed and fetched."""
        names = self._bucket.names(f"runs/{workflow}")
        sizes = {name: size for name, size in names.items() if _is_journal(name)}
        paths = {name: self._runs / workflow / name.rpartition("/")[2] for name in sizes}
        lacking = {name: path for name, path in paths.items() if _size(path) < sizes[name]}
        for folder in (self._runs, self._runs / workflow) if lacking else ():
            folder.mkdir(mode=0o700, exist_ok=True)
        asides = {name: path.with_name(f"fetched-{uuid.uuid4().hex}") for name, path in lacking.items()}
        try:
            self._bucket.download(asides)
        finally:
            for name, aside in asides.items():
                if aside.is_file():
                    aside.chmod(0o600)
                    aside.replace(lacking[name])
        return sorted((path for path in paths.values() if path.is_file()), reverse=True)

    def _journal(self, folder: Path, **facts: object) -> Journal:
        return RemoteJournal(folder, self._put, **facts)

    def _put(self, path: Path) -> None:
        self._bucket.put(f"runs/{path.parent.name}/{path.name}", path.read_bytes())


class RemoteJournal(Journal):
    """The journal of a run in progress, put into the bucket when it begins, as it grows, and when it ends.

    Opening it raises RemoteError if the bucket cannot be used. Later failures are ignored: the next put includes
    everything.
    """

    def __init__(self, folder: Path, put: Callable[[Path], None], **facts: object) -> None:
        self._put = put
        self._put_at = time.monotonic()
        super().__init__(folder, **facts)
        self._put(self.path)

    def _write(self, content: Mapping[str, object]) -> None:
        super()._write(content)
        if time.monotonic() - self._put_at > PUT_EVERY:
            self._put_if_possible()
            self._put_at = time.monotonic()

    def close(self) -> None:
        super().close()
        self._put_if_possible()

    def _put_if_possible(self) -> None:
        with suppress(RemoteError, OSError):
            self._put(self.path)


def _is_journal(name: str) -> bool:
    """Whether an object is the journal of a run. A workflow may have any name that a file can have."""
    return name.count("/") == 2 and name.endswith(".jsonl")


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else -1
