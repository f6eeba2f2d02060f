"""Artifacts of strangers: consistent in themselves, but made to run code, exhaust memory or read other files."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import pytest

from pipeline.artifact import create, load
from pipeline.canonical import digest_of_file
from pipeline.errors import CorruptArtifact
from pipeline.manifest import MANIFEST, FileRecord, Manifest, read_manifest, survey

ARRAY = Path("arrays.zarr/values")
CHUNK = ARRAY / "c/0"


@pytest.fixture
def artifact(tmp_path: Path) -> Path:
    with create(tmp_path / "artifact", "numbers") as writer:
        writer.write("values", np.arange(1000.0))
    return tmp_path / "artifact"


def finish_again(directory: Path, **changes: Any) -> None:
    """What a stranger can do: write a manifest that fits the files and says anything about arrays."""
    before = read_manifest(directory)
    arrays = {
        name: record | changes for name, record in json.loads((directory / MANIFEST).read_text())["arrays"].items()
    }
    (directory / MANIFEST).unlink()
    manifest = Manifest(before.kind, False, before.attributes, before.arrays, survey(directory))
    manifest.write(directory)
    content = json.loads((directory / MANIFEST).read_text())
    content["arrays"] = arrays
    content["digest"] = _digest(manifest, arrays)
    (directory / MANIFEST).write_text(json.dumps(content))


def _digest(manifest: Manifest, arrays: dict[str, Any]) -> str:
    from pipeline.manifest import ArrayRecord

    records = {
        name: ArrayRecord(r["dtype"], tuple(r["shape"]), tuple(r["chunks"]), r["sha256"]) for name, r in arrays.items()
    }
    return Manifest(manifest.kind, manifest.private, manifest.attributes, records, manifest.files).digest


def describe(directory: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = directory / ARRAY / "zarr.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def refused(directory: Path) -> None:
    artifact = load(directory)
    for attempt in (lambda: artifact.read("values"), lambda: artifact.open("values"), artifact.verify):
        with pytest.raises(CorruptArtifact):
            attempt()


def test_what_is_finished_again_can_be_read(artifact: Path) -> None:
    """Otherwise, the tests below would prove nothing."""
    finish_again(artifact)
    load(artifact).verify()
    np.testing.assert_array_equal(load(artifact).read("values"), np.arange(1000.0))


@pytest.mark.parametrize(
    "change",
    [lambda content: content.update(dimension_names=None), lambda content: content.pop("storage_transformers")],
)
def test_descriptions_as_another_zarr_writes_them(artifact: Path, change: Callable[[dict[str, Any]], object]) -> None:
    describe(artifact, change)
    finish_again(artifact)
    np.testing.assert_array_equal(load(artifact).read("values"), np.arange(1000.0))


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["codecs"].append({"name": "numcodecs.pickle", "configuration": {}}),
        lambda content: content["codecs"].insert(0, {"name": "vlen-utf8"}),
        lambda content: content.update(codecs=[{"name": "bytes", "configuration": {"endian": "little"}}]),
        lambda content: content.update(data_type="string"),
        lambda content: content.update(
            data_type={"name": "null_terminated_bytes", "configuration": {"length_bytes": 8}}
        ),
        lambda content: content.update(shape=[10**15]),
        lambda content: content.update(shape=[-1]),
        lambda content: content["chunk_grid"]["configuration"].update(chunk_shape=[10**15]),
        lambda content: content["chunk_grid"].update(name="rectilinear"),
        lambda content: content["chunk_key_encoding"].update(name="v2"),
        lambda content: content.update(storage_transformers=[{"name": "anything"}]),
        lambda content: content.update(zarr_format=2),
        lambda content: content.update(node_type="group"),
        lambda content: content.update(codecs="pickle"),
        lambda content: content.update(codecs=[["pickle"]]),
        lambda content: content.pop("fill_value"),
        lambda content: content.update(fill_value="1"),
        lambda content: content.update(fill_value=0),
        lambda content: content.update(attributes={"any": 1}),
        lambda content: content.update(anything=1),
        lambda content: content.update(dimension_names=[]),
        lambda content: content["codecs"][1]["configuration"].pop("checksum"),
        lambda content: content["codecs"][1]["configuration"].update(checksums=True),
        lambda content: content["codecs"][1]["configuration"].update(level=10**400),
        lambda content: content["codecs"][1].update(configuration=[]),
        lambda content: content.update(shape=[1000.0]),
        lambda content: content.clear(),
    ],
)
def test_descriptions_that_are_not_ours(artifact: Path, change: Callable[[dict[str, Any]], object]) -> None:
    describe(artifact, change)
    finish_again(artifact)
    refused(artifact)


def test_pickles_of_the_older_format_are_not_touched(artifact: Path, tmp_path: Path) -> None:
    """zarr would fall back to `.zarray`, whose filters may unpickle objects, and so run the code in them."""
    proof = tmp_path / "executed"

    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(proof),)

    folder = artifact / ARRAY
    (folder / "zarr.json").unlink()
    description = {
        "zarr_format": 2,
        "shape": [1],
        "chunks": [1],
        "dtype": "|O",
        "compressor": None,
        "fill_value": None,
        "order": "C",
        "filters": [{"id": "pickle", "protocol": 5}],
    }
    (folder / ".zarray").write_text(json.dumps(description))
    (folder / "0").write_bytes(pickle.dumps(np.array([Bomb()], dtype=object)))
    finish_again(artifact, dtype="|O", shape=[1], chunks=[1])
    refused(artifact)
    assert not proof.exists()


@pytest.mark.parametrize(
    ("shape", "chunks", "dtype"),
    [
        ([10**15], [10**15], "<f8"),
        ([10**15], [1000], "<f8"),
        ([1000], [10**12], "<f8"),
        ([-1000], [1000], "<f8"),
        ([1000], [-1000], "<f8"),
        ([1000], [0], "<f8"),
        ([1000, 1], [1000], "<f8"),
        ([1000.0], [1000], "<f8"),
        ([True], [1], "<f8"),
        ([1000], [1000], ">f8"),
        ([1000], [1000], "|O"),
        ([1000], [1000], "<f8,<f8"),
        ([1000], [1000], "<U8"),
    ],
)
def test_absurd_manifests(artifact: Path, shape: list[Any], chunks: list[int], dtype: str) -> None:
    def change(content: dict[str, Any]) -> None:
        content["shape"] = shape
        content["chunk_grid"]["configuration"]["chunk_shape"] = chunks

    describe(artifact, change)
    finish_again(artifact, shape=shape, chunks=chunks, dtype=dtype)
    refused(artifact)


def zstandard(data: bytes) -> bytes:
    return bytes(numcodecs.Zstd(level=3, checksum=True).encode(data))


UNCHECKED = bytes(numcodecs.Zstd(level=3, checksum=False).encode(np.arange(1000.0).tobytes()))


@pytest.mark.parametrize(
    "chunk",
    [
        zstandard(bytes(50_000_000)),
        zstandard(np.arange(1000.0).tobytes()) + zstandard(bytes(50_000_000)),
        zstandard(np.arange(1000.0).tobytes()) + b"more",
        zstandard(np.arange(1000.0).tobytes())[:-4],
        UNCHECKED,
        UNCHECKED + b"four",
        np.arange(1000.0).tobytes(),
        b"\x50\x2a\x4d\x18\x04\x00\x00\x00skip" + zstandard(np.arange(1000.0).tobytes()),
        b"",
        b"\x28\xb5\x2f\xfd",
    ],
    ids=[
        "bomb",
        "second frame",
        "more",
        "cut",
        "no checksum",
        "as long as with a checksum",
        "raw",
        "skippable",
        "empty",
        "head",
    ],
)
def test_chunks_that_unfold_into_something_else(artifact: Path, chunk: bytes) -> None:
    (artifact / CHUNK).write_bytes(chunk)
    finish_again(artifact)
    refused(artifact)


def test_a_chunk_that_says_how_much_memory_it_would_take(artifact: Path) -> None:
    """A few bytes that claim, as the manifest does, to be more than two gibibytes."""
    items = 2**28 + 1
    frame = b"\x28\xb5\x2f\xfd\xe4" + (8 * items).to_bytes(8, "little")
    one_byte_repeated = (2**17 << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    (artifact / CHUNK).write_bytes(frame + one_byte_repeated + b"sum?")

    def change(content: dict[str, Any]) -> None:
        content["shape"] = content["chunk_grid"]["configuration"]["chunk_shape"] = [items]

    describe(artifact, change)
    finish_again(artifact, shape=[items], chunks=[items])
    refused(artifact)


def test_other_numbers_under_a_manifest(artifact: Path) -> None:
    """A chunk that is sound in itself, but not the one that was written."""
    (artifact / CHUNK).write_bytes(zstandard(np.ones(1000).tobytes()))
    finish_again(artifact)
    with pytest.raises(CorruptArtifact, match="numbers that were written"):
        load(artifact).read("values")


def test_missing_and_foreign_chunks(artifact: Path) -> None:
    (artifact / CHUNK).rename(artifact / ARRAY / "c/1")
    finish_again(artifact)
    refused(artifact)
    (artifact / ARRAY / "c/0").write_bytes((artifact / ARRAY / "c/1").read_bytes())
    finish_again(artifact)
    refused(artifact)


@pytest.mark.parametrize("name", ["../../x", "/etc/passwd", "a/../../x", "a//b", "a\0b", "..", ""])
@pytest.mark.parametrize("where", ["files", "arrays"])
def test_names_that_lead_outside(artifact: Path, where: str, name: str) -> None:
    content, manifest = json.loads((artifact / MANIFEST).read_text()), read_manifest(artifact)
    content[where][name] = next(iter(content[where].values()))
    records = getattr(manifest, where)
    with suppress(IndexError):  # no digest covers a file without a name
        content["digest"] = replace(manifest, **{where: {**records, name: next(iter(records.values()))}}).digest
    (artifact / MANIFEST).write_text(json.dumps(content))
    with pytest.raises(CorruptArtifact, match="cannot name part of an artifact"):
        load(artifact)


@pytest.mark.parametrize("target", ["file", "folder", "manifest", "pipe"])
def test_links_and_pipes(artifact: Path, tmp_path: Path, target: str) -> None:
    """Nothing outside is read, and nothing waits for a pipe."""
    outside = tmp_path / "outside"
    paths = {"file": CHUNK, "folder": ARRAY / "c", "manifest": Path(MANIFEST), "pipe": CHUNK}
    path = artifact / paths[target]
    path.rename(outside)
    if target == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(outside)
    with pytest.raises(CorruptArtifact):
        load(artifact).verify()
    with pytest.raises(CorruptArtifact):
        load(artifact).read("values")


@pytest.mark.parametrize("value", ['"12"', "-1", "1e3", "true", "null", "[]", "1" * 5000, "[" * 100_000])
def test_absurd_sizes_of_files(artifact: Path, value: str) -> None:
    record = FileRecord((artifact / CHUNK).stat().st_size, digest_of_file(artifact / CHUNK))
    text = (artifact / MANIFEST).read_text()
    assert f'"size": {record.size}' in text
    (artifact / MANIFEST).write_text(text.replace(f'"size": {record.size}', f'"size": {value}'))
    with pytest.raises(CorruptArtifact):
        load(artifact).verify()
