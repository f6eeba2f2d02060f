"""Artifacts: what is written is what is read, the digest depends on the content alone, and damage is noticed."""

from __future__ import annotations

import itertools
import json
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import pipeline.artifact
from pipeline.artifact import create, default_chunks, load, publish
from pipeline.errors import ArtifactError, CorruptArtifact


def write(
    directory: Path, array: np.ndarray, *, kind: str = "scene", private: bool = False, **attributes: object
) -> str:
    with create(directory, kind, private) as writer:
        writer.write("group/array", array)
        writer.write_file("notes/read.txt", "hello")
        writer.attributes = dict(attributes)  # type: ignore[arg-type]  # tests pass wrong values on purpose
    return load(directory).digest


def test_round_trip(tmp_path: Path) -> None:
    array = np.arange(24, dtype=">f4").reshape(2, 3, 4)
    write(tmp_path / "a", array, names=["x", "y"])
    artifact = load(tmp_path / "a")
    assert (artifact.kind, artifact.private, artifact.names) == ("scene", False, ("group/array",))
    assert artifact.files == ("notes/read.txt",)
    assert artifact.attributes == {"names": ["x", "y"]}
    np.testing.assert_array_equal(artifact.read("group/array"), array)
    np.testing.assert_array_equal(artifact.open("group/array")[1:, :, 2], array[1:, :, 2])
    part = artifact.parts("group/array")
    np.testing.assert_array_equal(part(1), array[1])
    np.testing.assert_array_equal(part((slice(1, None), 2)), array[1:, 2])
    assert artifact.file("notes/read.txt").read_text() == "hello"
    artifact.verify()


@pytest.mark.parametrize("shape", [(), (0, 3), (5, 0, 2), (70_000, 2)])
def test_unusual_shapes(tmp_path: Path, shape: tuple[int, ...]) -> None:
    array = np.ones(shape, np.float64)
    write(tmp_path / "a", array)
    read = load(tmp_path / "a").read("group/array")
    assert read.shape == shape
    np.testing.assert_array_equal(read, array)


@settings(max_examples=8, deadline=None)
@given(array=arrays.arrays(st.sampled_from(["f4", "i8", "u1", "?"]), arrays.array_shapes(max_dims=3, max_side=4)))
def test_digest_is_of_the_content(tmp_path_factory: pytest.TempPathFactory, array: np.ndarray) -> None:
    directory = tmp_path_factory.mktemp("artifacts")
    digest = write(directory / "a", array)
    assert write(directory / "b", np.asfortranarray(array)) == digest, "memory layout"
    assert write(directory / "c", array.astype(array.dtype.newbyteorder(">"))) == digest, "byte order"
    assert write(directory / "d", array, kind="splats") != digest
    assert write(directory / "e", array, private=True) != digest
    assert write(directory / "f", array, note=1) != digest
    changed = array.copy()
    changed.flat[0] = not changed.flat[0]
    assert write(directory / "g", changed) != digest
    assert write(directory / "h", array[None]) != digest


def test_chunks_do_not_change_the_digest(tmp_path: Path) -> None:
    for name, chunks in (("a", (1, 4)), ("b", (3, 2))):
        with create(tmp_path / name, "scene") as writer:
            writer.write("x", np.arange(12.0).reshape(3, 4), chunks=chunks)
    assert load(tmp_path / "a").digest == load(tmp_path / "b").digest
    assert load(tmp_path / "a").open("x").chunks == (1, 4)


def test_one_picture_a_chunk_but_many_small_matrices() -> None:
    assert default_chunks((48, 144, 192, 3), 1) == (1, 144, 192, 3)
    assert default_chunks((48, 4, 4), 8) == (48, 4, 4)
    assert default_chunks((100_000, 16, 3), 4) == (65536, 16, 3)
    assert default_chunks((0, 3), 4) == (1, 3)


def test_zeros_are_stored_so_that_a_deleted_chunk_is_noticed(tmp_path: Path) -> None:
    write(tmp_path / "a", np.zeros((3, 200, 200)))
    chunks = sorted((tmp_path / "a").glob("arrays.zarr/group/array/c/**/*"))
    chunk = next(path for path in chunks if path.is_file())
    chunk.unlink()
    with pytest.raises(CorruptArtifact, match="missing"):
        load(tmp_path / "a").read("group/array")


def test_a_flipped_bit_is_noticed(tmp_path: Path) -> None:
    write(tmp_path / "a", np.random.default_rng(0).normal(size=(100, 3)))
    chunk = next(path for path in (tmp_path / "a").glob("arrays.zarr/group/array/c/**/*") if path.is_file())
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(CorruptArtifact):
        load(tmp_path / "a").read("group/array")
    with pytest.raises(CorruptArtifact, match="altered"):
        load(tmp_path / "a").verify()


@pytest.mark.parametrize("moment", range(3))
def test_an_artifact_that_is_set_aside_while_it_is_verified_is_not_sound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    """Another run may set it aside at any time: here just before one of its files is read."""
    write(tmp_path / "artifact", np.arange(4))
    artifact = load(tmp_path / "artifact")
    looks, digest = itertools.count(), pipeline.artifact.digest_of_file

    def aside_then_read(path: Path) -> str:
        if next(looks) == moment:
            artifact.path.rename(tmp_path / "aside")
        return digest(path)

    monkeypatch.setattr(pipeline.artifact, "digest_of_file", aside_then_read)
    with pytest.raises(CorruptArtifact):
        artifact.verify()


def test_parts_of_an_artifact_that_was_set_aside_are_no_zeros(tmp_path: Path) -> None:
    write(tmp_path / "artifact", np.arange(4))
    artifact = load(tmp_path / "artifact")
    part = artifact.parts("group/array")
    artifact.path.rename(tmp_path / "aside")
    with pytest.raises(CorruptArtifact, match="disappeared while"):
        part(1)


def test_what_is_foreign_costs_nothing(tmp_path: Path) -> None:
    """A file browser leaves files of its own wherever it looks."""
    write(tmp_path / "artifact", np.arange(4))
    artifact = load(tmp_path / "artifact")
    (artifact.path / ".DS_Store").write_text("?")
    (artifact.path / "arrays.zarr" / "link").symlink_to(tmp_path)
    artifact.verify()
    assert artifact.foreign() == (".DS_Store", "arrays.zarr/link")


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.update(kind="scene"),
        lambda content: content.update(private=True),
        lambda content: content["attributes"].update(count=2),
        lambda content: content["arrays"]["values"].update(dtype="<i8"),
        lambda content: content["arrays"]["values"].update(shape=[1, 3]),
        lambda content: content["files"].update({"notes.txt": {"size": 1, "sha256": "0"}}),
    ],
)
def test_a_manifest_that_was_altered_is_refused(tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Also of an artifact outside a store, where no folder is named after the digest."""
    with create(tmp_path / "a", "numbers") as writer:
        writer.write("values", np.zeros(3))
        writer.attributes["count"] = 1
    path = tmp_path / "a" / "manifest.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(CorruptArtifact, match="does not match the digest that it states"):
        load(tmp_path / "a")


def test_chunks_larger_than_their_array_are_refused(tmp_path: Path) -> None:
    """A chunk of two gibibytes that holds one number would take two gibibytes of memory whenever it is read."""
    with create(tmp_path / "a", "numbers") as writer:
        writer.write("values", np.zeros(3), chunks=(3000,))
    manifest = tmp_path / "a" / "manifest.json"
    content = json.loads(manifest.read_text())
    assert content["arrays"]["values"]["chunks"] == [3], "our own are no larger"
    content["arrays"]["values"]["chunks"] = [3000]
    manifest.write_text(json.dumps(content))
    with pytest.raises(CorruptArtifact, match=r"chunks of \(3000,\) in a shape of \(3,\)"):
        load(tmp_path / "a").read("values")


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"format": 1}', '{"format": 99}'])
def test_a_damaged_manifest_is_noticed(tmp_path: Path, damage: str) -> None:
    write(tmp_path / "a", np.zeros(3))
    (tmp_path / "a" / "manifest.json").write_text(damage)
    with pytest.raises(CorruptArtifact):
        load(tmp_path / "a")


def test_private_modes(tmp_path: Path) -> None:
    write(tmp_path / "a", np.zeros((2, 3)), private=True)
    for path in (tmp_path / "a", *(tmp_path / "a").rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_nothing_is_left_after_an_exception(tmp_path: Path) -> None:
    def fail() -> None:
        with create(tmp_path / "a", "scene") as writer:
            writer.write("x", np.zeros(3))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_moved_stays_where_it_is(tmp_path: Path) -> None:
    digest = write(tmp_path / "a", np.zeros(3))
    with pytest.raises(FileNotFoundError):
        publish(load(tmp_path / "a"), tmp_path / "no such folder" / "a")
    assert load(tmp_path / "a").digest == digest


@pytest.mark.parametrize("array", [np.array(["a"]), np.array([object()]), np.array([(1, 2)], dtype="i4,i4")])
def test_types_that_are_no_numbers_are_refused(tmp_path: Path, array: np.ndarray) -> None:
    with pytest.raises(ArtifactError, match="expected numbers"), create(tmp_path / "a", "scene") as writer:
        writer.write("x", array)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), b"bytes", {1: 2}, {1, 2}, np.float32(1)])
def test_attributes_that_json_cannot_say_are_refused(tmp_path: Path, value: object) -> None:
    with pytest.raises(ArtifactError, match="attribute 'x'"):
        write(tmp_path / "a", np.zeros(3), x=value)


@pytest.mark.parametrize("name", ["", "/etc/x", "../x", "a//b", "a/./b", "manifest.json", "arrays.zarr/x"])
def test_file_names_that_leave_the_artifact_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArtifactError), create(tmp_path / "a", "scene") as writer:
        writer.write_file(name, b"")
