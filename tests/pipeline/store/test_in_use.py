"""A store whose files cannot be locked is refused by name, with what to do about it."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import IO

import pytest

from pipeline.errors import CommandError
from pipeline.store.store import Store


@pytest.mark.parametrize("error", [errno.ENOLCK, errno.EOPNOTSUPP])
@pytest.mark.parametrize("alone", [False, True])
def test_a_disk_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, alone: bool) -> None:
    """Such as NFS without its lock manager."""

    def no_locks(file: IO[bytes], operation: int) -> None:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with pytest.raises(CommandError) as refused, Store(tmp_path / "store").in_use(alone=alone):
        pass
    assert str(refused.value) == (
        f"{tmp_path / 'store'}: a file here cannot be locked, so runs could interfere with each other; "
        f"found {os.strerror(error)}. Put the store on a disk that supports file locks, with --store or "
        "$GS_HIDER_STORE."
    )
