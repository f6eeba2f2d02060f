"""A scene comes back from its copy as the same artifact; what is no scene, damaged or private is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages import import_scene as module
from stages.import_scene import ImportSceneParameters, import_scene
from stages.scene.scene import read_scene, write_scene
from tests.running import run_stage
from tests.stages import small


def imported(folder: Path, outputs: Path, private: bool = False) -> Artifact:
    return run_stage(import_scene, ImportSceneParameters(folder=folder), {}, outputs, private=private)["scene"]


def refused(folder: Path, tmp_path: Path) -> str:
    with pytest.raises(UserError) as refusal:
        imported(folder, tmp_path / "refused" / folder.name)
    return str(refusal.value)


def scene_of(folder: Path, private: bool = False, **arrays: Any) -> Path:
    """The small scene with some arrays replaced, or missing if None."""
    original = small.scene(folder.with_name(f"{folder.name} original"))
    with create(folder, "scene", private) as writer:
        for name in original.names:
            values = arrays.get(name, original.read(name))
            if values is not None:
                writer.write(name, values)
        writer.attributes |= original.attributes
    return folder


def test_it_is_the_same_artifact_again(tmp_path: Path) -> None:
    scene = read_scene(small.scene(tmp_path / "small"))
    with create(tmp_path / "scene", "scene") as writer:
        write_scene(writer, scene, registered=8, total=9, mean_reprojection_error=0.7, pose_source="estimated")
    assert imported(tmp_path / "scene", tmp_path / "outputs").digest == load(tmp_path / "scene").digest


def test_a_private_scene_stays_private(tmp_path: Path) -> None:
    folder = scene_of(tmp_path / "scene", private=True)
    assert "a private scene would become public" in refused(folder, tmp_path)
    assert imported(folder, tmp_path / "outputs", private=True).private


def test_what_is_no_scene_is_told(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    said = refused(tmp_path / "empty", tmp_path)
    assert "scene missing or damaged" in said
    assert "cover_scene.scene, unpacked if zipped" in said
    small.splats(tmp_path / "splats")
    assert "not the expected kind of artifact; found splats; expected scene" in refused(tmp_path / "splats", tmp_path)


def test_names_of_arguments_are_no_facts(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    with create(folder, "scene") as writer:
        original = small.scene(tmp_path / "original")
        for name in original.names:
            writer.write(name, original.read(name))
        writer.attributes |= {**original.attributes, "writer": 1, "scene": "a text"}
    assert not {"writer", "scene"} & imported(folder, tmp_path / "outputs").attributes.keys()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("points", lambda values: values * np.float32(np.nan)),
        ("intrinsics", lambda values: values * 0),
        ("world_to_camera", lambda values: values * 0),
        ("world_to_camera", lambda values: values * np.diag([1, 1, -1, 1])),
    ],
)
def test_cameras_that_are_none_are_told(tmp_path: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    values = small.scene(tmp_path / "small").read(name)
    folder = scene_of(tmp_path / "scene", **{name: change(values)})
    assert "invalid cameras or points" in refused(folder, tmp_path)


def test_a_byte_that_was_changed_is_told(tmp_path: Path) -> None:
    folder = scene_of(tmp_path / "scene")
    chunk = folder / "arrays.zarr" / "points" / "c" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")
    assert "altered since it was written" in refused(folder, tmp_path)


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("pictures", None, "pictures are missing or of the wrong type or shape; found nothing"),
        ("pictures", np.zeros((8, 24, 32), np.uint8), r"found \|u1 \[8, 24, 32\]"),
        ("pictures", np.zeros((7, 24, 32, 3), np.uint8), "8 views, 7 pictures"),
        ("pictures", np.zeros((8, 0, 32, 3), np.uint8), "parts do not match"),
        ("points", np.zeros((60, 3)), "points are missing or of the wrong type or shape; found <f8"),
        ("points", np.zeros((61, 3), np.float32), "61 points and 60 point colours"),
        ("world_to_camera", np.full((8, 4, 4), np.nan), "world_to_camera is not finite"),
    ],
)
def test_arrays_that_no_scene_has_are_told(tmp_path: Path, name: str, values: np.ndarray | None, said: str) -> None:
    folder = scene_of(tmp_path / "scene", **{name: values})
    with pytest.raises(UserError, match=said):
        imported(folder, tmp_path / "outputs")


def test_it_is_told_before_it_is_unfolded_that_a_scene_is_too_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = scene_of(tmp_path / "scene")
    monkeypatch.setattr(module, "LARGEST", 1000)
    monkeypatch.setattr(Artifact, "read", lambda *_: pytest.fail("was read"))
    assert "the scene is too large" in refused(folder, tmp_path)


def with_names(folder: Path, *names: str) -> Path:
    """The small scene with its first views renamed; the first is the only test view."""
    scene = read_scene(load(scene_of(folder.with_name("named otherwise"))))
    with create(folder, "scene") as writer:
        write_scene(writer, scene)
        writer.attributes |= {"names": [*names, *scene.cameras.names[len(names) :]], "test_names": [names[0]]}
    return folder


def test_views_of_one_name_are_told(tmp_path: Path) -> None:
    assert "parts do not match" in refused(with_names(tmp_path / "twice", "a.png", "a.png"), tmp_path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("b\0\x1b[2J", r"name of a photo cannot be written; found 'b\x00\x1b[2J'"),
        ("", "name of a photo cannot be written"),
        ("b" * 301, "no file can have the name of a photo"),
        ("../b.png\\", "no file can have the name of a photo"),
    ],
)
def test_names_of_views_that_no_file_can_have_are_told(tmp_path: Path, name: str, said: str) -> None:
    assert said in refused(with_names(tmp_path / "named", name), tmp_path)
