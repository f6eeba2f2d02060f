"""Artifacts in a bucket: nobody sees a part of one, and nobody takes away the files of one that is being put."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.store.bucket.bucket import Bucket, Entry
from pipeline.store.bucket.remote_artifacts import RemoteArtifacts

DAY = 86400.0


class InMemory(Bucket):
    """A bucket without a server, whose `order` is that in which folders were written to and deleted from."""

    def __init__(self) -> None:
        super().__init__("s3://bucket/store")
        self.objects: dict[str, bytes] = {}
        self.ages: dict[str, float] = {}
        self.order: list[str] = []

    def get(self, name: str) -> bytes | None:
        return self.objects.get(name)

    def put(self, name: str, data: bytes) -> None:
        self.order.append(name.split("/")[0])
        self.objects[name] = data

    def upload(self, files: Mapping[str, Path]) -> None:
        for name, path in files.items():
            self.put(name, path.read_bytes())

    def delete(self, names: Iterable[str]) -> None:
        for name in [*names]:
            self.order.append(name.split("/")[0])
            del self.objects[name]

    def listing(self, folder: str) -> dict[str, Entry]:
        named = {name: data for name, data in self.objects.items() if name.startswith(f"{folder}/")}
        return {name: Entry(len(data), self.ages.get(name, 0.0)) for name, data in named.items()}


@pytest.fixture
def bucket() -> InMemory:
    return InMemory()


@pytest.fixture
def artifact(tmp_path: Path) -> Artifact:
    with create(tmp_path / "artifact", "numbers") as writer:
        writer.write("values", np.arange(3))
        writer.write_file("notes.txt", "hello")
    return load(tmp_path / "artifact")


def test_the_manifest_is_put_last_and_deleted_first(bucket: InMemory, artifact: Artifact) -> None:
    artifacts = RemoteArtifacts(bucket)
    artifacts.put(artifact)
    assert bucket.order[-1] == "manifests"
    assert set(bucket.order[:-1]) == {"files"}
    bucket.order.clear()
    artifacts.delete(artifact.digest)
    assert bucket.order[0] == "manifests"
    assert set(bucket.order[1:]) == {"files"}
    assert not bucket.objects


def test_what_is_there_is_not_put_again_but_for_a_file_that_was_cut_off(bucket: InMemory, artifact: Artifact) -> None:
    artifacts = RemoteArtifacts(bucket)
    artifacts.put(artifact)
    whole = dict(bucket.objects)
    bucket.order.clear()
    artifacts.put(artifact)
    assert bucket.order == []
    cut = next(name for name in whole if name.startswith("files/"))
    bucket.objects[cut] = whole[cut][:-1]
    artifacts.put(artifact)
    assert bucket.objects == whole


def test_files_without_a_manifest_are_unfinished_when_none_has_come_for_a_day(bucket: InMemory) -> None:
    """Not while others follow, nor beside the manifest of what was withdrawn as damaged."""
    files = {digest: [f"files/{digest * 64}/{number}" for number in range(2)] for digest in "abcd"}
    bucket.objects = {name: b"123" for names in files.values() for name in names}
    bucket.ages = dict.fromkeys(bucket.objects, 2 * DAY) | {files["b"][1]: 60.0}
    bucket.objects |= {f"damaged/objects/{'c' * 64}.json": b"", f"manifests/{'d' * 64}.json": b""}
    assert RemoteArtifacts(bucket).unfinished(DAY) == {f"files/{'a' * 64}": 6}
