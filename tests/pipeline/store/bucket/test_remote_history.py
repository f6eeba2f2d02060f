"""The journal of a run whose results are in a bucket, when the bucket cannot be reached."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import Unreachable
from pipeline.store.bucket import remote_history
from pipeline.store.bucket.remote_history import RemoteJournal
from pipeline.store.history import StageResult


class Far:
    """A bucket that can be reached or not."""

    def __init__(self) -> None:
        self.reached = True
        self.tried = 0
        self.content = b""

    def put(self, path: Path) -> None:
        self.tried += 1
        if not self.reached:
            raise Unreachable("the connection broke off")
        self.content = path.read_bytes()


def test_a_bucket_that_is_not_reached_meanwhile_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_history, "PUT_EVERY", -1.0)
    far = Far()
    journal = RemoteJournal(tmp_path, far.put)
    far.reached = False
    before = far.tried
    journal.add(StageResult("a", "cached"))
    journal.end()
    assert far.tried == before + 2
    far.reached = True
    journal.close()
    assert far.content == journal.path.read_bytes()
    assert b'"ended"' in far.content


def test_nor_one_that_is_not_reached_at_its_end(tmp_path: Path) -> None:
    far = Far()
    journal = RemoteJournal(tmp_path, far.put)
    far.reached = False
    journal.close()
    assert far.tried == 2


def test_a_bucket_that_is_not_reached_is_told_at_the_beginning(tmp_path: Path) -> None:
    far = Far()
    far.reached = False
    with pytest.raises(Unreachable):
        RemoteJournal(tmp_path, far.put)
