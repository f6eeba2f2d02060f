"""The points of a COLMAP model become those of the scene, as in 3DGS, and no photos are compared for it."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.errors import UserError
from pipeline.stage import Services
from stages.imaging.pictures import encode_png
from stages.photos import PhotosParameters, photos
from stages.scene.alignment import nearest_depth, project
from stages.scene.cameras import Cameras
from stages.scene.capture import KnownPoses, picture_path, read_capture, write_capture
from stages.scene.drawn_depths import AMPLE
from stages.scene.known_points import KnownPoints
from stages.scene.lens import Lens
from stages.scene.ply.writing import write_ply
from stages.scene.scene import read_scene
from stages.scene.world_scale import world_scale_of
from stages.sfm import SfmParameters, points_to_keep
from tests.running import run_stage
from tests.stages.scene.rigs import arc
from tests.stages.scene.test_colmap_points import binary_point
from tests.stages.test_sfm import (
    SIZE,
    VIEWS,
    photograph,
    run,
    walls,
    write,
)

NAMES = [f"{view:02d}.png" for view in range(VIEWS)]
LEFT_OUT = 90
"""The number of a photo that is not in the model."""


@pytest.fixture(scope="module")
def truth() -> Cameras:
    return arc(np.zeros(3), views=VIEWS, degrees=50, radius=5.0, height=0.8, size=SIZE, focal=240.0)


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    """Points on the walls, in no order."""
    along = np.random.default_rng(3).uniform(0.1, 0.9, (100, 2))
    wall = walls()[np.arange(100) % 4]
    return wall[:, 0] + along[:, :1] * wall[:, 1] + along[:, 1:] * wall[:, 2]


def points_of_model(cameras: Cameras, positions: np.ndarray) -> list:
    """Every third point is also seen by a photo that was left out, every tenth only by that one; numbers descend."""
    pixels, _ = project(cameras, positions)
    inside = ((pixels > 0) & (pixels < SIZE)).all(axis=-1)
    points = []
    for row, position in enumerate(positions):
        seen = [(10 + view, 0) for view in np.flatnonzero(inside[:, row])] if row % 10 else []
        away = [(LEFT_OUT, 0)] if not row % 10 or not row % 3 else []
        color = (row, 2 * row, 255 - row)
        points.append((1000 - row, tuple(position.tolist()), color, 0.25 + row / 64, [*seen, *away]))
    return points


def write_model(folder: Path, cameras: Cameras, points: list, form: str) -> None:
    """Write a model whose photos are numbered from 10 on and listed backwards."""
    folder.mkdir(parents=True)
    lens = [float(cameras.intrinsics[0][at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    posed = []
    for view in reversed(range(len(cameras))):
        x, y, z, w = Rotation.from_matrix(cameras.world_to_camera[view, :3, :3]).as_quat().tolist()
        posed.append((10 + view, (w, x, y, z, *cameras.world_to_camera[view, :3, 3].tolist()), NAMES[view]))
    if form == "text":
        (folder / "cameras.txt").write_text(f"1 PINHOLE {SIZE[0]} {SIZE[1]} {' '.join(map(repr, lens))}\n")
        lines = [f"{number} {' '.join(map(repr, pose))} 1 {name}\n\n" for number, pose, name in posed]
        (folder / "images.txt").write_text("".join(lines))
        rows = [(number, *at, *color, error, *np.ravel(views)) for number, at, color, error, views in points]
        (folder / "points3D.txt").write_text("".join(" ".join(map(str, row)) + "\n" for row in rows))
        return
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, *SIZE, *lens))
    images = [struct.pack("<I7dI", n, *pose, 1) + f"{name}\0".encode() + bytes(8) for n, pose, name in posed]
    (folder / "images.bin").write_bytes(struct.pack("<Q", len(images)) + b"".join(images))
    content = b"".join(binary_point(*point) for point in points)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", len(points)) + content)


@pytest.mark.parametrize("form", ["binary", "text"])
def test_the_points_of_a_model_are_those_of_the_scene(
    truth: Cameras, positions: np.ndarray, form: str, tmp_path: Path, recorded: dict[str, Json]
) -> None:
    for name, picture in zip(NAMES, photograph(truth), strict=True):
        (tmp_path / "photos" / "images").mkdir(parents=True, exist_ok=True)
        (tmp_path / "photos" / "images" / name).write_bytes(encode_png(picture))
    points = points_of_model(truth, positions)
    write_model(tmp_path / "photos" / "sparse" / "0", truth, points, form)
    log: list[str] = []
    services = Services(log=log.append)
    parameters = PhotosParameters(folder=tmp_path / "photos")
    capture = run_stage(photos, parameters, {}, tmp_path, services=services)["capture"]
    assert "90 points came with the poses" in log
    made = run(capture, tmp_path / "out", services)
    scene = read_scene(made)
    kept = [point for row, point in enumerate(points) if row % 10]
    np.testing.assert_array_equal(scene.points, np.array([at for _, at, *_ in kept], np.float32))
    np.testing.assert_array_equal(scene.point_colors, [color for _, _, color, *_ in kept])
    np.testing.assert_allclose(scene.cameras.world_to_camera, truth.world_to_camera, atol=1e-9)
    weights = [sum(photo != LEFT_OUT for photo, _ in views) for *_, views in kept]
    expected = np.average([error for *_, error, _ in kept], weights=weights)
    assert made.attributes["mean_reprojection_error"] == pytest.approx(expected)
    assert (recorded["point_source"], recorded["unsure_poses"]) == ("colmap", [])
    assert set(recorded["seconds_of_phases"].values()) == {0.0}  # type: ignore[union-attr]  # an object
    assert not any(line.startswith(("features", "matching", "mapping")) for line in log)
    assert not list((tmp_path / "out").rglob("*.db"))


def test_a_model_with_a_ply_for_its_points(truth: Cameras, positions: np.ndarray, tmp_path: Path) -> None:
    """Programs that match no photos write one for 3DGS, which reads it before any other."""
    for name, picture in zip(NAMES, photograph(truth), strict=True):
        (tmp_path / "photos" / "images").mkdir(parents=True, exist_ok=True)
        (tmp_path / "photos" / "images" / name).write_bytes(encode_png(picture))
    model = tmp_path / "photos" / "sparse" / "0"
    write_model(model, truth, [], "binary")
    (model / "points3D.bin").unlink()
    axes = {axis: positions[:, row].astype(np.float32) for row, axis in enumerate("xyz")}
    colors = {name: np.full(len(positions), 90, np.uint8) for name in ("red", "green", "blue")}
    write_ply(model / "points3D.ply", axes | colors)
    made = run_stage(photos, PhotosParameters(folder=tmp_path / "photos"), {}, tmp_path / "out")["capture"]
    poses = read_capture(made).poses
    assert poses is not None
    assert poses.points is not None
    np.testing.assert_allclose(poses.points.positions, positions, rtol=1e-6)
    assert (poses.points.seen > 0.5 * len(positions)).all()


def given(truth: Cameras, points: KnownPoints | None, directory: Path, lenses: tuple[Lens, ...] = ()) -> Artifact:
    """A capture with the poses of a COLMAP model and these points."""
    made = write(truth, "colmap", directory, photographs=photograph(truth), lenses=lenses)
    if points is None:
        return made
    capture = read_capture(made)
    assert capture.poses is not None
    with create(directory / "with points", "capture") as writer:
        whole = replace(capture, poses=replace(capture.poses, points=points))
        write_capture(writer, whole, lambda name: picture_path(made, name))
    return load(directory / "with points")


def known(positions: np.ndarray, seen: int = 50, error: float | None = 0.5) -> KnownPoints:
    """Points of which every photo sees `seen`, but the last one only 9."""
    colors = np.zeros(positions.shape, np.uint8)
    return KnownPoints(positions, colors, np.array([seen] * (VIEWS - 1) + [9]), error)


def test_all_but_the_points_is_as_if_they_were_triangulated(
    truth: Cameras, positions: np.ndarray, tmp_path: Path, recorded: dict[str, Json]
) -> None:
    """The lenses, distorted and zoomed differently, the pinhole for all, and what is recorded of them are the same."""
    lenses = tuple(Lens("SIMPLE_RADIAL", (240.0 + 10 * view, 100.0, 75.0, 0.02), *SIZE) for view in range(VIEWS))
    capture = given(truth, known(positions, error=None), tmp_path, lenses)
    log: list[str] = []
    scene = run(capture, tmp_path / "given", Services(log=log.append))
    facts = dict(recorded)
    assert scene.attributes["mean_reprojection_error"] is None
    assert any(line.endswith("100 points that came with the poses, reprojection error unknown") for line in log)
    assert facts["unsure_poses"] == [NAMES[-1]]
    other = run(capture, tmp_path / "triangulated", points="triangulate")
    assert recorded["point_source"] == "triangulated"
    for name in ("pictures", "intrinsics"):
        np.testing.assert_array_equal(scene.read(name), other.read(name))
    np.testing.assert_allclose(scene.read("world_to_camera"), other.read("world_to_camera"), atol=1e-12)
    assert facts["lenses"] == recorded["lenses"]
    assert facts["shares_shown"] == recorded["shares_shown"]


def test_points_of_small_units_are_enlarged_with_their_poses(
    truth: Cameras, positions: np.ndarray, tmp_path: Path
) -> None:
    capture = given(truth, known(positions), tmp_path)
    poses = truth.world_to_camera.copy()
    poses[:, :3, 3] *= 0.01
    with create(tmp_path / "tiny", "capture") as writer:
        whole = read_capture(capture)
        assert whole.poses is not None
        small = replace(whole.poses, world_to_camera=poses, points=known(positions * 0.01))
        write_capture(writer, replace(whole, poses=small), lambda name: picture_path(capture, name))
    scene = read_scene(run(load(tmp_path / "tiny"), tmp_path / "out"))
    assert nearest_depth(scene.cameras, scene.points) == pytest.approx(AMPLE, rel=1e-5)
    factor = scene.cameras.world_to_camera[0, :3, 3] / poses[0, :3, 3]
    assert world_scale_of(load(tmp_path / "out" / "scene")) == pytest.approx(factor[0])
    np.testing.assert_allclose(scene.points, positions * 0.01 * factor[0], rtol=1e-5)


def test_lenses_that_fold_over_are_told_beside_points_too(
    truth: Cameras, positions: np.ndarray, tmp_path: Path
) -> None:
    folded = Lens("SIMPLE_RADIAL", (90.0, 100.0, 75.0, -0.4), *SIZE)
    lenses = (*[Lens("SIMPLE_RADIAL", (240.0, 100.0, 75.0, 0.02), *SIZE)] * (VIEWS - 1), folded)
    with pytest.raises(UserError, match=r"that of 1 photos \(07\.png\)"):
        run(given(truth, known(positions), tmp_path, lenses), tmp_path / "out")


def test_which_points_are_kept(truth: Cameras, positions: np.ndarray) -> None:
    lenses = tuple(Lens.pinhole(matrix, *SIZE) for matrix in truth.intrinsics)
    enough, few = (KnownPoses("colmap", truth.world_to_camera, lenses, known(positions[:count])) for count in (10, 9))
    without = replace(few, points=None)
    assert points_to_keep(enough, SfmParameters()) is enough.points
    assert points_to_keep(enough, SfmParameters(points="given")) is enough.points
    assert points_to_keep(enough, SfmParameters(points="triangulate")) is None
    for poses, found in ((few, "9 points"), (without, "0 points"), (None, "estimated poses, whose")):
        assert points_to_keep(poses, SfmParameters()) is None
        with pytest.raises(UserError, match=rf"{found}.*at least 10 .*points3D\.bin or \.txt.*SFM\.points=auto"):
            points_to_keep(poses, SfmParameters(points="given"))


def test_a_capture_without_points_is_laid_out_as_ever(truth: Cameras, tmp_path: Path) -> None:
    capture = given(truth, None, tmp_path)
    assert capture.names == ("intrinsics", "world_to_camera")
    assert {name for name in capture.attributes if "point" in name} == set()
    whole = read_capture(capture)
    assert whole.poses is not None
    assert whole.poses.points is None


def test_points_of_a_capture_are_read_as_they_were_written(
    truth: Cameras, positions: np.ndarray, tmp_path: Path
) -> None:
    points = known(positions)
    capture = read_capture(given(truth, points, tmp_path))
    assert capture.poses is not None
    read = capture.poses.points
    assert read is not None
    for name in ("positions", "colors", "seen"):
        np.testing.assert_array_equal(getattr(read, name), getattr(points, name))
        assert getattr(read, name).dtype == getattr(points, name).dtype
    assert read.error == points.error


def test_photos_of_one_number_cannot_be_told_apart_by_points(
    truth: Cameras, positions: np.ndarray, tmp_path: Path
) -> None:
    folder = tmp_path / "photos"
    write_model(folder, truth, points_of_model(truth, positions), "text")
    for name in NAMES:
        (folder / name).write_bytes(encode_png(np.zeros((SIZE[1], SIZE[0], 3), np.uint8)))
    images = folder / "images.txt"
    images.write_text(images.read_text().replace("\n11 ", "\n12 "))
    with pytest.raises(UserError, match="2 photos of a COLMAP model have the number 12"):
        run_stage(photos, PhotosParameters(folder=folder), {}, tmp_path)
