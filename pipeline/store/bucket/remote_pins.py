"""Pins of a store in a bucket, kept only there, so that `gc` on one machine keeps what was pinned on another."""

from __future__ import annotations

from pathlib import PurePosixPath

from pipeline.store.bucket.bucket import Bucket
from pipeline.store.pins import NAME, Pins


class RemotePins(Pins):
    """The pins of the store in a bucket. Methods also raise RemoteError if the bucket cannot be used."""

    def __init__(self, bucket: Bucket) -> None:
        self._bucket = bucket

    @property
    def names(self) -> list[str]:
        """Names of all pins, sorted."""
        found = [PurePosixPath(name) for name in self._bucket.names("pins")]
        return sorted(path.stem for path in found if path.suffix == ".json" and NAME.fullmatch(path.stem))

    def _place(self, name: str) -> str:
        return f"{self._bucket.address}/{_pin_name(name)}"

    def _data(self, name: str) -> bytes:
        data = self._bucket.get(_pin_name(name))
        if data is None:
            raise FileNotFoundError("no such pin")
        return data

    def _create(self, name: str, data: bytes) -> bool:
        return self._bucket.create(_pin_name(name), data)

    def _delete(self, name: str) -> None:
        self._bucket.delete([_pin_name(name)])


def _pin_name(name: str) -> str:
    return f"pins/{name}.json"
