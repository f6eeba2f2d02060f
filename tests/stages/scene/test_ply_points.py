"""The points that a transforms.json names are taken as those of a COLMAP model are."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Services
from stages.imaging.pictures import encode_png
from stages.photos import PhotosParameters, photos
from stages.scene.capture import read_capture
from stages.scene.ply.writing import write_ply
from stages.scene.ply_points import COUNTED, GREY
from stages.scene.scene import read_scene
from stages.sfm import SfmParameters, sfm
from tests.running import run_stage

VIEWS, SIZE = 4, (40, 30)


def positions(count: int = 500) -> np.ndarray:
    return np.random.default_rng(0).uniform([-1, -0.6, -3], [1, 0.6, -2], (count, 3))


def columns(points: np.ndarray) -> dict[str, np.ndarray]:
    shades = {
        name: np.arange(len(points), dtype=np.uint8) + shift for shift, name in enumerate(("red", "green", "blue"))
    }
    return {axis: points[:, row].astype(np.float32) for row, axis in enumerate("xyz")} | shades


def capture_folder(folder: Path, named: str | None = "sparse_pc.ply", sees: bool = True) -> Path:
    """Grey photos, in which nothing can be matched, of cameras that stand along x and look at the points."""
    frames = []
    for view in range(VIEWS):
        name = f"images/{view}.png"
        (folder / "images").mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(encode_png(np.full((SIZE[1], SIZE[0], 3), 90 + view, np.uint8)))
        pose = np.eye(4)
        pose[0, 3] = 0.2 * view
        if not sees and view == 0:
            pose[:3, :3] = np.diag([-1, 1, -1])  # looks the other way
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    said = {"camera_angle_x": math.pi / 2, "frames": frames} | ({"ply_file_path": named} if named else {})
    (folder / "transforms.json").write_text(json.dumps(said))
    return folder


def capture(folder: Path, out: Path, log: list[str] | None = None) -> Artifact:
    services = Services(log=(log if log is not None else []).append)
    return run_stage(photos, PhotosParameters(folder=folder), {}, out, services=services)["capture"]


def test_they_are_those_of_the_scene_and_nothing_is_matched(tmp_path: Path) -> None:
    folder = capture_folder(tmp_path / "captured")
    write_ply(folder / "sparse_pc.ply", columns(positions()))
    log: list[str] = []
    made = capture(folder, tmp_path / "photos", log)
    assert "500 points came with the poses" in log
    chosen = SfmParameters(width=40, matching_size=64)
    scene = read_scene(run_stage(sfm, chosen, {"capture": made}, tmp_path / "scene")["scene"])
    np.testing.assert_allclose(scene.points, positions(), rtol=1e-6)
    np.testing.assert_array_equal(scene.point_colors[:, 1], np.arange(500, dtype=np.uint8) + 1)


@pytest.mark.parametrize("count", [50, 2 * COUNTED + 1])
def test_a_photo_sees_what_lies_before_it(tmp_path: Path, count: int) -> None:
    folder = capture_folder(tmp_path / "captured", sees=False)
    write_ply(folder / "sparse_pc.ply", columns(positions(count)))
    poses = read_capture(capture(folder, tmp_path / "photos")).poses
    assert poses is not None
    assert poses.points is not None
    assert poses.points.seen[0] == 0
    assert (poses.points.seen[1:] > 0.9 * count).all()
    assert (poses.points.seen <= count).all()


def test_points_without_colours_are_grey(tmp_path: Path) -> None:
    folder = capture_folder(tmp_path / "captured")
    write_ply(folder / "sparse_pc.ply", {axis: columns(positions())[axis] for axis in "xyz"})
    poses = read_capture(capture(folder, tmp_path / "photos")).poses
    assert poses is not None
    assert poses.points is not None
    assert (poses.points.colors == GREY).all()


@pytest.mark.parametrize("named", [None, "missing.ply", "../outside.ply", "images", "a\0b.ply", 5000 * "a"])
def test_a_file_that_is_not_in_the_folder_is_none(tmp_path: Path, named: str | None) -> None:
    folder = capture_folder(tmp_path / "captured", named)
    write_ply(tmp_path / "outside.ply", columns(positions()))
    poses = read_capture(capture(folder, tmp_path / "photos")).poses
    assert poses is not None
    assert poses.points is None


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    folder = capture_folder(tmp_path / "captured")
    write_ply(tmp_path / "outside.ply", columns(positions()))
    (folder / "sparse_pc.ply").symlink_to(tmp_path / "outside.ply")
    poses = read_capture(capture(folder, tmp_path / "photos")).poses
    assert poses is not None
    assert poses.points is None


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"x": np.full(500, np.nan, np.float32)}, "point 0 of a PLY is outside any plausible scene; found nan"),
        ({"y": np.full(500, 3e30, np.float32)}, "point 0 of a PLY is outside any plausible scene"),
        ({"z": np.zeros(500, np.uint8)}, "no usable z; found uint8; expected float32 or float64"),
        ({"green": np.zeros(500, np.float32)}, "no usable green; found float32; expected uint8"),
    ],
)
def test_points_that_are_none_are_refused(tmp_path: Path, changed: dict[str, np.ndarray], said: str) -> None:
    folder = capture_folder(tmp_path / "captured")
    write_ply(folder / "sparse_pc.ply", columns(positions()) | changed)
    with pytest.raises(UserError, match=said):
        capture(folder, tmp_path / "photos")


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    folder = capture_folder(tmp_path / "captured")
    (folder / "sparse_pc.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    with pytest.raises(UserError, match=r"sparse_pc\.ply"):
        capture(folder, tmp_path / "photos")


def test_few_posed_photos_that_are_not_there_are_left_out(tmp_path: Path) -> None:
    folder = capture_folder(tmp_path / "captured", named=None)
    (folder / "images" / "2.png").unlink()
    log: list[str] = []
    assert read_capture(capture(folder, tmp_path / "photos", log)).names == ("0.png", "1.png", "3.png")
    assert "1 pose belongs to a missing photo, left out, such as images/2.png" in log
    (folder / "images" / "1.png").unlink()
    with pytest.raises(UserError, match=r"the poses refer to photos that do not exist.* found 2 of 4"):
        capture(folder, tmp_path / "again")
