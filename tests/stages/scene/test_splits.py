"""Captures with a file of poses per split: which photos belong to them, and how these are named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stages.scene.capture import picture_path, read_capture
from tests.stages.scene.test_transforms import MATRIX
from tests.stages.test_photos import capture, expect_refusal, take


def nerf_synthetic(folder: Path, **names: list[str]) -> None:
    """Write a capture like those rendered with Blender: a folder and a file of poses for each split."""
    for split, frames in names.items():
        for name in frames:
            take(folder / split / f"{Path(name).name}.png", size=(64, 64))
            take(folder / split / f"{Path(name).name}_depth_0001.png", size=(64, 64))
        posed = [{"file_path": f"./{split}/{name}", "rotation": 0.01, "transform_matrix": MATRIX} for name in frames]
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.69, "frames": posed}))


def test_splits_of_nerfs_synthetic_scenes(tmp_path: Path) -> None:
    folder = tmp_path / "lego"
    nerf_synthetic(folder, train=["r_0", "r_1"], val=["r_0"], test=["r_0", "r_1", "r_2"])
    log: list[str] = []
    artifact = capture(folder, tmp_path / "out", log)
    found = read_capture(artifact)
    assert found.names == ("test_r_0.png", "test_r_1.png", "test_r_2.png", "train_r_0.png", "train_r_1.png")
    assert artifact.attributes["test_names"] == ["test_r_0.png", "test_r_1.png", "test_r_2.png"]
    assert picture_path(artifact, "test_r_1.png").read_bytes() == (folder / "test" / "r_1.png").read_bytes()
    assert found.poses is not None
    assert found.poses.source == "transforms"
    assert found.poses.lenses[4].matrix()[0, 0] == pytest.approx(32 / np.tan(0.345))
    assert any("transforms_train.json and transforms_test.json" in line for line in log)


def write_split(folder: Path, split: str, paths: list[str]) -> None:
    posed = [{"file_path": path, "transform_matrix": MATRIX} for path in paths]
    (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.69, "frames": posed}))


def test_splits_of_photos_in_several_folders(tmp_path: Path) -> None:
    """Names leave out a folder that holds a whole split and keep others: a rig's cameras number their photos alike."""
    folder = tmp_path / "rig"
    frames = {"train": ["train/left/r_0", "train/left/r_1.png", "./train/right/r_0"], "test": ["other/far/r_0"]}
    for split, paths in frames.items():
        for path in paths:
            take(folder / f"{path.removesuffix('.png')}.png", size=(64, 64 + 2 * ("right" in path)))
        write_split(folder, split, paths)
    artifact = capture(folder, tmp_path / "out")
    found = read_capture(artifact)
    assert found.names == ("test_r_0.png", "train_left_r_0.png", "train_left_r_1.png", "train_right_r_0.png")
    assert artifact.attributes["test_names"] == ["test_r_0.png"]
    right = folder / "train" / "right" / "r_0.png"
    assert picture_path(artifact, "train_right_r_0.png").read_bytes() == right.read_bytes()
    assert found.poses is not None
    assert [lens.height for lens in found.poses.lenses] == [64, 64, 64, 66]


def test_splits_whose_photos_would_be_called_the_same_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    paths = ["train/left/far_0", "train/left_far/0"]
    for path in paths:
        take(folder / f"{path}.png", size=(64, 64))
    write_split(folder, "train", paths)
    expect_refusal(folder, tmp_path / "out", "left_far_0.png", "left/far_0.png and left_far/0.png")
    write_split(folder, "train", ["train/left/far_0", "./train/left/far_0.png"])
    expect_refusal(folder, tmp_path / "twice", "far_0.png is posed twice")


def test_a_test_split_whose_photos_were_never_made_is_none(tmp_path: Path) -> None:
    """BlenderNeRF writes the cameras of its test split, and renders the training split only."""
    folder = tmp_path / "scene"
    nerf_synthetic(folder, train=["r_0", "r_1"])
    write_split(folder, "test", ["test/0001.png", "test/0002.png"])
    made = capture(folder, tmp_path / "out")
    assert read_capture(made).names == ("train_r_0.png", "train_r_1.png")
    assert "test_names" not in made.attributes


def test_few_photos_of_a_split_that_are_missing_are_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "lego"
    nerf_synthetic(folder, train=["r_0", "r_1", "r_2", "r_3"], test=["r_0"])
    (folder / "train" / "r_2.png").unlink()
    log: list[str] = []
    found = read_capture(capture(folder, tmp_path / "out", log))
    assert found.names == ("test_r_0.png", "train_r_0.png", "train_r_1.png", "train_r_3.png")
    assert any(line.endswith("left out, such as ./train/r_2") or "left out, such as train/r_2" in line for line in log)
    (folder / "train" / "r_3.png").unlink()
    expect_refusal(folder, tmp_path / "again", "transforms_train.json", "do not exist", "2 of 4")


def test_names_that_the_split_makes_too_long_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    paths = [f"train/{'a' * 120}/{'b' * 124}/r_0", "train/c/r_0"]
    for path in paths:
        take(folder / f"{path}.png", size=(64, 64))
    write_split(folder, "train", paths)
    expect_refusal(folder, tmp_path / "out", "no file can have the name of a photo", "train_aaa", "of 259 bytes")


def test_a_folder_of_photos_is_not_asked_for_beside_splits(tmp_path: Path) -> None:
    nerf_synthetic(tmp_path / "lego", train=["r_0"], test=["r_0"])
    found = "images: train, and transforms_train.json and transforms_test.json"
    expect_refusal(tmp_path / "lego", tmp_path / "out", found, "Leave images out", images="train")


def test_splits_without_frames(tmp_path: Path) -> None:
    folder = tmp_path / "lego"
    nerf_synthetic(folder, train=["r_0", "r_1"], test=[])
    artifact = capture(folder, tmp_path / "out")
    assert read_capture(artifact).names == ("train_r_0.png", "train_r_1.png")
    assert "test_names" not in artifact.attributes
    nerf_synthetic(folder, train=[], test=["r_0"])
    expect_refusal(folder, tmp_path / "none", "transforms_train.json", "without poses")


@pytest.mark.parametrize("frame", ["../elsewhere/r_0", "/etc/r_0", "train/r_7", "", "train", "a\0b", "a" * 5000])
def test_frames_whose_photo_is_not_in_the_capture_are_refused(tmp_path: Path, frame: str) -> None:
    nerf_synthetic(tmp_path / "lego", train=["r_0"])
    take(tmp_path / "elsewhere" / "r_0.png")
    posed = [{"file_path": frame, "transform_matrix": MATRIX}]
    (tmp_path / "lego" / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 1, "frames": posed}))
    expect_refusal(tmp_path / "lego", tmp_path / "out", "transforms_train.json", "do not exist")
