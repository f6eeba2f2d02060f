"""Structure from motion end to end: on four walls of noise, and on real captures where these are available."""

from __future__ import annotations

import io
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services
from stages.photos import PhotosParameters, photos
from stages.scene.alignment import nearest_depth, project
from stages.scene.cameras import Cameras
from stages.scene.capture import Capture, KnownPoses, PoseSource, picture_path, read_capture, write_capture
from stages.scene.drawn_depths import AMPLE
from stages.scene.lens import Lens
from stages.scene.reconstruction_job import Reconstruction
from stages.scene.scene import Scene, read_scene
from stages.scene.structure_from_motion import Settings, refuse_few
from stages.sfm import SfmParameters, sfm
from stages.synthesize import SynthesizeParameters, synthesize
from tests.running import run_stage
from tests.stages.scene.rigs import arc

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
SIZE = (200, 150)
VIEWS = 8


def walls() -> np.ndarray:
    """Four textured rectangles at different depths, each with its origin and the sides along and up."""
    return np.array(
        [
            [[-0.6, -2.4, -1.5], [0, 3.0, 0.2], [0, 0, 3.0]],
            [[-1.2, 0.2, -1.6], [0.3, 3.0, 0], [0.2, 0, 3.2]],
            [[0.4, -1.0, -1.2], [0.2, 1.2, 0], [0, 0.1, 1.1]],
            [[0.7, 0.3, 0.1], [-0.2, 1.1, 0], [0.1, 0, 1.0]],
        ]
    )


def photograph(cameras: Cameras) -> list[np.ndarray]:
    """Pictures of the walls, papered with blotches and drawn from far to near, each by a homography."""
    random = np.random.default_rng(5)
    papers = [
        cv2.resize(random.integers(0, 256, (80, 80, 3), dtype=np.uint8), (640, 640), interpolation=cv2.INTER_CUBIC)
        for _ in walls()
    ]
    pictures = []
    for view in range(len(cameras)):
        pose, intrinsics = cameras.world_to_camera[view], cameras.intrinsics[view]
        picture = np.full((cameras.height, cameras.width, 3), 90, np.uint8)
        for paper, (origin, along, up) in zip(papers, walls(), strict=True):
            plane = np.stack([along / 640, up / 640, origin], axis=1)
            homography = intrinsics @ (pose[:3, :3] @ plane + np.outer(pose[:3, 3], [0, 0, 1]))
            seen = cv2.warpPerspective(np.full(paper.shape, 255, np.uint8), homography, SIZE)
            picture = np.where(seen > 127, cv2.warpPerspective(paper, homography, SIZE), picture)
        pictures.append(picture)
    return pictures


@pytest.fixture(scope="module")
def truth() -> Cameras:
    return arc(np.zeros(3), views=VIEWS, degrees=50, radius=5.0, height=0.8, size=SIZE, focal=240.0)


@pytest.fixture(scope="module")
def synthetic(truth: Cameras, tmp_path_factory: pytest.TempPathFactory) -> Artifact:
    return write(truth, "synthetic", tmp_path_factory.mktemp("synthetic"))


def write(
    truth: Cameras,
    source: PoseSource,
    directory: Path,
    photographs: list[np.ndarray] | None = None,
    lenses: tuple[Lens, ...] = (),
) -> Artifact:
    names = tuple(f"{view:02d}.png" for view in range(len(truth)))
    lenses = lenses or tuple(Lens.pinhole(matrix, *SIZE) for matrix in truth.intrinsics)
    poses = KnownPoses(source, truth.world_to_camera, lenses)
    capture = Capture(names, (SIZE,) * len(names), (None,) * len(names), ordered=True, poses=poses)
    with create(directory / "capture", "capture") as writer:
        pictures = dict(zip(names, map(encoded, photographs or photograph(truth)), strict=True))
        write_capture(writer, capture, pictures.__getitem__)
    return load(directory / "capture")


def encoded(picture: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return buffer.getvalue()


def run(capture: Artifact, directory: Path, services: Services | None = None, **parameters: object) -> Artifact:
    directory.mkdir(parents=True, exist_ok=True)
    chosen = SfmParameters(**{"width": 100, **parameters})
    return run_stage(sfm, chosen, {"capture": capture}, directory, services=services)["scene"]


@pytest.fixture(scope="module")
def estimated(synthetic: Artifact, tmp_path_factory: pytest.TempPathFactory) -> Artifact:
    return run(synthetic, tmp_path_factory.mktemp("estimated"))


def test_true_cameras_are_recovered(estimated: Artifact) -> None:
    facts = estimated.attributes
    assert (facts["registered"], facts["total"], facts["pose_source"]) == (VIEWS, VIEWS, "estimated")
    assert facts["pose_error_position"] < 0.02
    assert facts["pose_error_rotation"] < 1.0
    assert facts["mean_reprojection_error"] < 1.0
    assert facts["test_names"] == ["00.png"]


def test_the_scene_is_whole(estimated: Artifact) -> None:
    scene = read_scene(estimated)
    assert scene.pictures.shape == (VIEWS, 74, 100, 3)
    expect_points_where_pictures_show_them(scene)


def expect_points_where_pictures_show_them(scene: Scene) -> None:
    assert len(scene.points) == len(scene.point_colors) > 50
    pixels, depth = project(scene.cameras, scene.points.astype(np.float64))
    assert (depth > 0).all()
    nearest = pixels.astype(int).clip(0, np.array(scene.pictures.shape[2:0:-1]) - 1)
    shown = np.stack([scene.pictures[view, at[:, 1], at[:, 0]] for view, at in enumerate(nearest)]).astype(float)
    difference = np.abs(np.median(shown, axis=0) - scene.point_colors).mean()
    assert difference < 30  # of 255: pictures, cameras, points and colours fit together


def test_the_same_bits_again(synthetic: Artifact, estimated: Artifact, tmp_path: Path) -> None:
    assert run(synthetic, tmp_path).digest == estimated.digest


def test_photos_larger_than_they_are_matched_at_are_shown_whole(truth: Cameras, tmp_path: Path) -> None:
    """As for phones' photos; here 200 pixels, matched at 150."""
    capture = write(truth, "colmap", tmp_path)
    smaller, whole = (read_scene(run(capture, tmp_path / f"{size}", matching_size=size)) for size in (150, SIZE[0]))
    expect_points_where_pictures_show_them(smaller)
    np.testing.assert_allclose(smaller.cameras.intrinsics, whole.cameras.intrinsics, rtol=1e-6)
    np.testing.assert_allclose(smaller.pictures.astype(float), whole.pictures.astype(float), atol=3)


@pytest.mark.parametrize("source", ["synthetic", "colmap"])
def test_given_poses_are_kept(truth: Cameras, source: PoseSource, tmp_path: Path) -> None:
    capture = write(truth, source, tmp_path)
    scene = run(capture, tmp_path / "out", poses="given" if source == "synthetic" else "auto")
    np.testing.assert_allclose(scene.read("world_to_camera"), truth.world_to_camera, atol=1e-9)
    expected = truth.intrinsics[0, 0, 0] * 100 / SIZE[0]
    assert scene.read("intrinsics")[0, 0, 0] == pytest.approx(expected, rel=1e-6)
    assert scene.attributes["pose_source"] == source
    on_wall = scene.read("points")
    nearest = np.abs(distances_to_walls(on_wall.astype(np.float64))).min(axis=1)
    assert np.median(nearest) < 0.02


def test_poses_of_small_units_are_enlarged_until_what_they_see_is_drawn(
    truth: Cameras, tmp_path: Path, recorded: dict[str, Json]
) -> None:
    """As for a close-up in metres, all of which would lie before the near plane."""
    tiny = truth.world_to_camera.copy()
    tiny[:, :3, 3] *= 0.01
    capture = write(replace(truth, world_to_camera=tiny), "colmap", tmp_path, photographs=photograph(truth))
    log: list[str] = []
    scene = read_scene(run(capture, tmp_path / "out", Services(log=log.append)))
    assert nearest_depth(scene.cameras, scene.points) == pytest.approx(AMPLE, rel=1e-5)
    factor = scene.cameras.world_to_camera[0, :3, 3] / tiny[0, :3, 3]
    np.testing.assert_allclose(scene.cameras.world_to_camera[:, :3, 3], tiny[:, :3, 3] * factor[0], rtol=1e-6)
    expect_points_where_pictures_show_them(scene)
    assert any("enlarged" in line for line in log)
    assert recorded["unsure_poses"] == []


def test_poses_that_are_to_be_given_are_not_estimated_where_none_came(tmp_path: Path) -> None:
    with create(tmp_path / "capture", "capture") as writer:
        capture = Capture(("a.png", "b.png", "c.png"), (SIZE,) * 3, (None,) * 3, ordered=False)
        write_capture(writer, capture, lambda name: encoded(np.zeros((*SIZE[::-1], 3), np.uint8)))
    with pytest.raises(UserError, match=r"none came.*3 photos without poses.*transforms\.json.*SFM\.poses=auto"):
        run(load(tmp_path / "capture"), tmp_path / "out", poses="given")


def test_every_photo_may_have_a_lens_of_its_own(truth: Cameras, tmp_path: Path, recorded: dict[str, Json]) -> None:
    """The zoom varies; all photos come out as by one pinhole camera, and the share shown of each is recorded."""
    zoomed = truth.intrinsics.copy()
    zoomed[:, [0, 1], [0, 1]] *= np.linspace(1, 1.4, VIEWS)[:, None]
    cameras = replace(truth, intrinsics=zoomed)
    scene = read_scene(run(write(cameras, "colmap", tmp_path), tmp_path / "out"))
    focal_lengths = scene.cameras.intrinsics[:, 0, 0]
    assert focal_lengths == pytest.approx(zoomed[-1, 0, 0] * 100 / SIZE[0], rel=1e-6)
    assert len(scene.cameras) == VIEWS
    expect_points_where_pictures_show_them(scene)
    assert recorded["shares_shown"] == pytest.approx((np.linspace(1, 1.4, VIEWS) / 1.4) ** 2, abs=1e-3)


def test_cameras_that_differ_get_a_lens_each(synthetic: Artifact, tmp_path: Path, recorded: dict[str, Json]) -> None:
    given = replace(read_capture(synthetic), poses=None, taken_by=(0, 0, 0, 1, 1, 1, 1, 1))
    with create(tmp_path / "capture", "capture") as writer:
        write_capture(writer, given, lambda name: picture_path(synthetic, name))
    scene = run(load(tmp_path / "capture"), tmp_path / "out")
    assert len(read_scene(scene).cameras) == VIEWS
    assert len(set(map(str, recorded["lenses"]))) == 2  # type: ignore[arg-type]  # a list


def test_given_lenses_that_fold_over_are_told_with_their_photos_before_any_work(truth: Cameras, tmp_path: Path) -> None:
    real = Lens("SIMPLE_RADIAL", (240.0, 100.0, 75.0, 0.02), *SIZE)
    folded = Lens("SIMPLE_RADIAL", (90.0, 100.0, 75.0, -0.4), *SIZE)
    capture = write(truth, "colmap", tmp_path, lenses=(real, folded, *[real] * (VIEWS - 3), folded))
    log: list[str] = []
    with pytest.raises(UserError, match=r"that of 2 photos \(01\.png, 07\.png\).*file of poses.*SFM\.poses=estimate"):
        run(capture, tmp_path / "out", Services(log=log.append))
    assert not any("features" in line for line in log)


def test_photos_left_out_for_their_lenses_are_told_where_too_few_are_left(synthetic: Artifact) -> None:
    settings = Settings(100, 960, "auto", 8192, "SIMPLE_RADIAL", minimum_registered=0.5, seed=0)
    result = nothing_placed(folded=(2, 3))
    with pytest.raises(
        UserError, match=r"placed 0 of 8 photos; found besides, 2 photos \(02\.png, 03\.png\).*panoramas"
    ):
        refuse_few(read_capture(synthetic), result, settings, given=False)


def nothing_placed(folded: tuple[int, ...] = ()) -> Reconstruction:
    points, colors = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    return Reconstruction((), np.empty((0, 4, 4)), np.eye(3), (), (), (), points, colors, 0.0, (), folded, (), {}, "")


def distances_to_walls(points: np.ndarray) -> np.ndarray:
    normals = np.cross(walls()[:, 1], walls()[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.einsum("pwi,wi->pw", points[:, None] - walls()[None, :, 0], normals)


def test_poses_that_do_not_fit_are_found_out(truth: Cameras, tmp_path: Path) -> None:
    """The commonest mistake: cameras that look along -z, as in OpenGL, given as COLMAP's."""
    turned = np.diag([1.0, -1.0, -1.0, 1.0]) @ truth.world_to_camera
    capture = write(replace(truth, world_to_camera=turned), "colmap", tmp_path, photographs=photograph(truth))
    with pytest.raises(UserError, match=r"points.*--set SFM\.poses=estimate to the command, where SFM is the stage's"):
        run(capture, tmp_path / "out")


def test_photos_that_show_nothing_in_common_are_refused_with_advice(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    names = tuple(f"{view}.png" for view in range(4))
    pictures = {name: encoded(random.integers(0, 256, (60, 80, 3), dtype=np.uint8)) for name in names}
    with create(tmp_path / "capture", "capture") as writer:
        write_capture(writer, Capture(names, ((80, 60),) * 4, (None,) * 4, ordered=False), pictures.__getitem__)
    with pytest.raises(UserError, match=r"placed 0 of 4 photos.*50%.*overlap.*such as cover_scene") as refusal:
        run(load(tmp_path / "capture"), tmp_path / "out")
    told = dict(re.findall(r"--set SFM\.(\w+)=(\w+)", str(refusal.value)))
    assert SfmParameters.model_validate(told).matching == "exhaustive"
    others = set(re.findall(r"SFM\.(\w+)", str(refusal.value))) - told.keys()
    assert others == {"matching_size", "max_features", "minimum_registered"} <= SfmParameters.model_fields.keys()


def test_a_request_to_stop_ends_the_process_and_what_was_done_is_used_again(
    synthetic: Artifact, estimated: Artifact, tmp_path: Path
) -> None:
    asked = threading.Event()
    stopping = Services(
        progress=lambda done, total, figures: asked.set() if done > 25 else None, stop_requested=asked.is_set
    )
    with pytest.raises(Interrupted):
        run(synthetic, tmp_path / "out", stopping)
    database = tmp_path / "out" / ".scratch" / "reconstruction" / "database.db"
    written = database.stat().st_size
    time.sleep(0.5)
    assert database.stat().st_size == written > 100_000  # nothing is written any more, and the features are there
    (tmp_path / "out" / ".scene").rename(tmp_path / "abandoned")
    assert run(synthetic, tmp_path / "out").digest == estimated.digest


def test_a_database_that_a_power_cut_damaged_is_made_anew_and_the_log_says_so(
    synthetic: Artifact, estimated: Artifact, tmp_path: Path
) -> None:
    folder = tmp_path / "out" / ".scratch" / "reconstruction"
    folder.mkdir(parents=True)
    (folder / "database.db").write_bytes(b"SQLite format 3\0" + bytes(10_000))
    (folder / "database.db-wal").write_bytes(b"left over")
    (folder / "database.new").write_bytes(b"left over")
    log: list[str] = []
    assert run(synthetic, tmp_path / "out", Services(log=log.append)).digest == estimated.digest
    assert any("interrupted run are damaged and found anew: file is not a database" in line for line in log)


HELD_OUT = ("07.png", "02.png", "not placed.png")


@pytest.mark.parametrize(
    ("held_out", "parameters", "expected", "said"),
    [
        (HELD_OUT, {}, ("02.png", "07.png"), "2 of 8 views are test views according to the pose files"),
        (HELD_OUT, {"test_views": "every_eighth"}, ("00.png",), None),
        ((), {}, ("00.png",), None),
        (("not placed.png",), {}, ("00.png",), "0 of the 8 views were held out for tests: every eighth"),
        (tuple(f"{view:02d}.png" for view in range(VIEWS)), {}, ("00.png",), "8 of the 8 views were held out"),
    ],
)
def test_the_split_that_came_with_a_capture_is_kept(
    synthetic: Artifact,
    estimated: Artifact,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    held_out: tuple[str, ...],
    parameters: dict[str, str],
    expected: tuple[str, ...],
    said: str | None,
) -> None:
    """For views that were placed, and unless none would be left to test or to train on."""
    whole = replace(read_capture(synthetic), test_names=held_out)
    with create(tmp_path / "capture", "capture") as writer:
        write_capture(writer, whole, lambda name: picture_path(synthetic, name))
    assert load(tmp_path / "capture").attributes.get("test_names", []) == [*held_out]
    monkeypatch.setattr("stages.sfm.reconstruct", lambda *arguments: (read_scene(estimated), nothing_placed()))
    log: list[str] = []
    scene = read_scene(run(load(tmp_path / "capture"), tmp_path / "out", Services(log=log.append), **parameters))
    assert scene.test_names == expected
    assert set(scene.train_names) == {*scene.cameras.names} - {*expected}
    assert [said in line for line in log if "test" in line] == ([] if said is None else [True])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least", "size"), [("kitchen", 22, 1600), ("fox", 48, 960)])
def test_real_captures_are_placed(name: str, least: int, size: int, tmp_path: Path) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"the capture {name} is not at hand in {DATA}")
    (tmp_path / "photos").mkdir()
    capture = run_stage(photos, PhotosParameters(folder=DATA / name), {}, tmp_path / "photos")["capture"]
    scene = run(capture, tmp_path / "out", width=192, matching_size=size)
    assert scene.attributes["registered"] >= least
    assert scene.attributes["mean_reprojection_error"] < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["courtyard", "library", "reef", "workshop"])
def test_the_cameras_of_built_in_scenes_are_recovered(scene: str, tmp_path: Path) -> None:
    """With default settings. A wall that looks like another can put cameras on its wrong side."""
    (tmp_path / "photos").mkdir()
    capture = run_stage(synthesize, SynthesizeParameters(scene=scene), {}, tmp_path / "photos")["capture"]
    facts = run(capture, tmp_path / "out", width=192).attributes
    assert facts["registered"] == facts["total"] == 48
    assert facts["pose_error_position"] < 0.01
    assert facts["pose_error_rotation"] < 1.0
