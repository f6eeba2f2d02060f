"""Opening the store at an address: a bucket, or a folder that is a store or empty."""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.errors import CommandError
from pipeline.store.absent_store import AbsentStore
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.bucket.remote import RemoteStore
from pipeline.store.external import from_home
from pipeline.store.git_ignored import IGNORED
from pipeline.store.record import RECORD
from pipeline.store.store import IN_USE, LOCKS, Store


def open_store(address: str | Path, make: bool = True) -> Store:
    """The store at an address: a folder, or `s3://BUCKET/PREFIX`.

    A folder that is missing or empty becomes a store; unless `make`, it is left as it is, and an empty store stands in
    for it. Raises CommandError for an invalid address or a folder that holds something else, OSError if the folder
    cannot be read or created.
    """
    if "://" in str(address):
        return RemoteStore(Bucket(str(address)))
    if str(address).startswith("s3:"):
        raise CommandError("not a bucket address", found=address, expected="s3://BUCKET/PREFIX, with two slashes")
    root = from_home(address)
    if not str(address):
        raise CommandError("the address of the store is empty", expected="a folder, or s3://BUCKET/PREFIX")
    if is_store(root):
        return Store(root)
    found = sorted(entry.name for entry in root.iterdir()) if root.is_dir() else []
    if set(found) - {LOCKS, IGNORED}:  # with these alone, another run is just creating it, or it was emptied
        raise CommandError(
            "the folder contains something else",
            where=root,
            found=", ".join(found[:5]),
            expected="a store, or an empty or new folder",
            remedy="Say where to keep results with --store or $GS_HIDER_STORE.",
        )
    if not make and (root.is_dir() or not os.path.lexists(root)):
        return AbsentStore(root)
    store = Store(root)
    store.mark()
    return store


def is_store(root: Path) -> bool:
    """Whether a folder is a store, of this or an earlier version, or a copy of one without its locks.

    Commands check this first: in any other folder, `gc`, which deletes what nobody needs, and `verify`, which sets
    aside what is damaged, would take everything.
    """
    return (root / LOCKS / IN_USE).is_file() or any((root / "actions").glob(f"*/{RECORD}"))
