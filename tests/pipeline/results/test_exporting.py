"""Copies of artifacts: equal to the original, complete or absent, and closed to others if private."""

from __future__ import annotations

import os
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zarr

from pipeline.artifact import Artifact, create, load
from pipeline.errors import CommandError, CorruptArtifact
from pipeline.results.exporting import export_artifact
from pipeline.store.store import Store


def artifact(folder: Path, private: bool = False) -> Artifact:
    with create(folder / "original", "views", private) as writer:
        writer.write("deep/pictures", np.arange(2 * 32 * 32 * 3, dtype=np.uint8).reshape(2, 32, 32, 3))
        writer.write("poses", np.eye(4))
        writer.write_file("notes/read.txt", "words")
        writer.attributes["names"] = ["a", "b"]
    return load(folder / "original")


@pytest.mark.parametrize("private", [False, True])
def test_a_folder_that_load_opens(tmp_path: Path, private: bool) -> None:
    original = artifact(tmp_path, private)
    export_artifact(original, tmp_path / "new" / "copy", zipped=False)
    copy = load(tmp_path / "new" / "copy")
    copy.verify()
    assert (copy.digest, copy.private) == (original.digest, private)
    np.testing.assert_array_equal(copy.read("deep/pictures"), original.read("deep/pictures"))
    assert copy.file("notes/read.txt").read_text() == "words"
    modes = {stat.S_IMODE(path.stat().st_mode) & 0o77 for path in (copy.path.parent, copy.path, *copy.path.rglob("*"))}
    assert (modes == {0}) is private
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["copy"], "nothing else is left there"


@pytest.mark.parametrize("private", [False, True])
def test_a_zip_of_the_same_layout(tmp_path: Path, private: bool) -> None:
    original = artifact(tmp_path, private)
    for name in ("a.zip", "b.zip"):
        export_artifact(original, tmp_path / name, zipped=True)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert stat.S_IMODE((tmp_path / "a.zip").stat().st_mode) & 0o77 == (0 if private else 0o44)
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        modes = {entry.external_attr >> 16 for entry in archive.infolist()}
        assert modes == {0o600 if private else 0o644}, "what unpacks it may set them"
        archive.extractall(tmp_path / "unpacked")
    load(tmp_path / "unpacked").verify()
    assert load(tmp_path / "unpacked").digest == original.digest
    with zarr.storage.ZipStore(tmp_path / "a.zip", mode="r") as zipped:
        group = zarr.open_group(zipped, path="arrays.zarr", mode="r")
        np.testing.assert_array_equal(group["poses"][...], np.eye(4))


@pytest.mark.parametrize("stands", ["pipe", "link"])
def test_what_is_no_file_is_never_opened(tmp_path: Path, stands: str) -> None:
    original = artifact(tmp_path)
    file = original.path / "notes" / "read.txt"
    file.unlink()
    if stands == "pipe":
        os.mkfifo(file)  # opening it would wait for ever
    else:
        file.symlink_to("/dev/zero")  # copying it would end only with a full disk
    with pytest.raises(CorruptArtifact):
        export_artifact(original, tmp_path / "copy", zipped=False)
    assert not (tmp_path / "copy").exists()


def test_nothing_is_replaced(tmp_path: Path) -> None:
    original = artifact(tmp_path)
    (tmp_path / "there").write_text("mine")
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("there", "link"):
        with pytest.raises(CommandError, match="already exists"):
            export_artifact(original, tmp_path / name, zipped=False)
    assert (tmp_path / "there").read_text() == "mine"


@pytest.mark.parametrize("zipped", [False, True])
def test_a_damaged_artifact_leaves_nothing(tmp_path: Path, zipped: bool) -> None:
    original = artifact(tmp_path)
    chunk = next(original.path.glob("arrays.zarr/poses/c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")
    with pytest.raises(CorruptArtifact, match="altered"):
        export_artifact(original, tmp_path / "copy", zipped)
    assert [path.name for path in tmp_path.iterdir()] == ["original"]


def test_files_that_are_not_the_artifacts_own_stay_behind(tmp_path: Path) -> None:
    original = artifact(tmp_path)
    (original.path / "foreign").write_text("?")
    export_artifact(original, tmp_path / "copy", zipped=False)
    assert not (tmp_path / "copy" / "foreign").exists()


def test_not_into_the_store(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    with pytest.raises(CommandError, match="inside the store"):
        export_artifact(artifact(tmp_path), store.root / "objects" / "copy", zipped=False, store=store)
