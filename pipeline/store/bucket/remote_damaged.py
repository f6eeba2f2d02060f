"""The damaged records of a store in a bucket, besides the damaged data of its mirror."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pipeline.store.bucket.bucket import Bucket
from pipeline.store.damaged import Damaged, name_in_damaged
from pipeline.store.record import Record, read_record

SUFFIX = ".json"  # of names in the bucket; names in the mirror have none


class RemoteDamaged(Damaged):
    """The damaged data of the store in a bucket; that of its mirror is in `folder`.

    `temporary` returns new paths to write to. Methods raise RemoteError if the bucket cannot be used.
    """

    def __init__(self, folder: Path, bucket: Bucket, temporary: Callable[[], Path]) -> None:
        super().__init__(folder)
        self._bucket = bucket
        self._temporary = temporary

    def take_record(self, key: str, name: str) -> None:
        """Copies the record of an action, `name` in the bucket, to `damaged`, if it exists."""
        data = self._bucket.get(name)
        if data is not None:
            self._bucket.put(damaged_record_name(key), data)

    def record(self, name: str) -> Record | None:
        if not name.endswith(SUFFIX):
            return super().record(name)
        key = name_in_damaged(name)
        data = self._bucket.get(damaged_record_name(key))
        if data is None:
            return None
        aside = self._temporary()
        aside.write_bytes(data)
        return read_record(aside, key)


def damaged_record_name(key: str) -> str:
    """The name in the bucket of an action's damaged record."""
    return f"damaged/actions/{key}{SUFFIX}"
