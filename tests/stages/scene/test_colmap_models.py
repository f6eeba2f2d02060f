"""Every camera model is read back as COLMAP writes it, as text and binary; so is a folder of Mip-NeRF 360."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import UserError
from stages.imaging.pictures import encode_jpeg, read_picture
from stages.photos import PhotosParameters, photos
from stages.scene.capture import picture_path, read_capture
from stages.scene.colmap import read_colmap_model
from stages.scene.lens import MODELS, Lens
from stages.sfm import SfmParameters, sfm
from tests.running import run_stage
from tests.stages.scene.rigs import arc
from tests.stages.test_sfm import SIZE, photograph

REPOSITORY = Path(__file__).parents[3]
DATA = REPOSITORY.parent / "shared" / "data"


def write_models(directory: Path, models: list[dict]) -> None:
    """Write models with pycolmap, in a process of its own."""
    (directory / "models.json").write_text(json.dumps(models))
    subprocess.run(
        [sys.executable, "-m", "tests.stages.scene.write_colmap_models", str(directory / "models.json")],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
    )


def lens_of(model: str) -> Lens:
    focal_lengths, distortions = MODELS[model]
    distortion = [0.01 * (number + 1) for number in range(distortions)]
    return Lens(model, (*[500.0, 510.0][:focal_lengths], 320.0, 240.0, *distortion), 640, 480)


def test_every_camera_model_is_read_back(tmp_path: Path) -> None:
    pose = arc(np.zeros(3), views=3).world_to_camera[1]
    models = []
    for model in MODELS:
        lens = lens_of(model)
        camera = [model, lens.width, lens.height, lens.parameters]
        named = [{"name": f"{row} of 2.jpg", "world_to_camera": pose.tolist(), "camera": camera} for row in (1, 2)]
        models += [
            {"folder": str(tmp_path / form / model), "form": form, "photos": named} for form in ("text", "binary")
        ]
    write_models(tmp_path, models)
    for one in models:
        folder = Path(one["folder"])
        posed = read_colmap_model(folder)
        assert [photo.name for photo in posed] == ["1 of 2.jpg", "2 of 2.jpg"]
        assert posed[0].lens == lens_of(folder.name), one["form"]
        np.testing.assert_allclose(posed[1].world_to_camera, pose, atol=1e-12)


@pytest.fixture(scope="module")
def mip_nerf_360(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture as downloaded: photos in three sizes, COLMAP's model of the largest, poses of another program."""
    folder = tmp_path_factory.mktemp("garden")
    truth = arc(np.zeros(3), views=8, degrees=50, radius=5.0, height=0.8, size=SIZE, focal=240.0)
    names = [f"DSC{8000 + view}.JPG" for view in range(8)]
    for times, place in ((4, "images"), (2, "images_2"), (1, "images_4")):
        (folder / place).mkdir()
        for name, picture in zip(names, photograph(truth), strict=True):
            larger = cv2.resize(picture, (SIZE[0] * times, SIZE[1] * times - (times == 4)))
            (folder / place / name).write_bytes(encode_jpeg(larger, 95))
    width, height = SIZE[0] * 4, SIZE[1] * 4 - 1  # an odd height, not divisible by 4
    camera = ["PINHOLE", width, height, [960.0, 960.0 * height / 600, width / 2, height / 2]]
    posed = [
        {"name": name, "world_to_camera": pose.tolist(), "camera": camera}
        for name, pose in zip(names, truth.world_to_camera, strict=True)
    ]
    write_models(folder, [{"folder": str(folder / "sparse" / "0"), "form": "binary", "photos": posed}])
    np.save(folder / "poses_bounds.npy", np.zeros((8, 17)))
    return folder


@pytest.mark.parametrize(
    ("images", "size"), [(None, (800, 599)), ("images", (800, 599)), ("images_2", (400, 300)), ("images_4", (200, 150))]
)
def test_photos_of_mip_nerf_360(mip_nerf_360: Path, images: str | None, size: tuple[int, int], tmp_path: Path) -> None:
    made = run_stage(photos, PhotosParameters(folder=mip_nerf_360, images=images), {}, tmp_path)["capture"]
    capture = read_capture(made)
    assert len(capture.names) == 8
    assert set(capture.sizes) == {size}
    assert read_picture(picture_path(made, "DSC8000.JPG")).shape == (size[1], size[0], 3)
    assert capture.poses is not None
    assert capture.poses.source == "colmap"
    focal = 960 * size[0] / 800
    expected = [[focal, 0, size[0] / 2], [0, 960 * 599 / 600 * size[1] / 599, size[1] / 2], [0, 0, 1]]
    np.testing.assert_allclose(capture.poses.lenses[0].matrix(), expected, rtol=1e-9)


def test_a_size_that_is_not_there(mip_nerf_360: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"without a folder images_8; found .*images, images_2, images_4"):
        run_stage(photos, PhotosParameters(folder=mip_nerf_360, images="images_8"), {}, tmp_path)


@pytest.mark.parametrize("images", ["..", "../other", ".hidden", "a/b", ""])
def test_photos_come_from_the_capture_itself(images: str) -> None:
    with pytest.raises(ValueError, match="images"):
        PhotosParameters(folder=Path("garden"), images=images)


def test_points_of_mip_nerf_360_are_triangulated_and_its_poses_kept(mip_nerf_360: Path, tmp_path: Path) -> None:
    made = run_stage(photos, PhotosParameters(folder=mip_nerf_360, images="images_4"), {}, tmp_path)["capture"]
    scene = run_stage(sfm, SfmParameters(width=100), {"capture": made}, tmp_path)["scene"]
    truth = arc(np.zeros(3), views=8, degrees=50, radius=5.0, height=0.8, size=SIZE, focal=240.0)
    np.testing.assert_allclose(scene.read("world_to_camera"), truth.world_to_camera, atol=1e-9)
    assert scene.attributes["pose_source"] == "colmap"
    assert scene.attributes["test_names"] == ["DSC8000.JPG"]
    assert scene.attributes["mean_reprojection_error"] < 1.5
    assert len(scene.read("points")) > 50


def test_photos_of_mip_nerf_360_are_trained_on_as_they_are(mip_nerf_360: Path, tmp_path: Path) -> None:
    """Except for an odd last row: training pictures are not resampled, and each axis keeps its focal length."""
    made = run_stage(photos, PhotosParameters(folder=mip_nerf_360, images="images"), {}, tmp_path)["capture"]
    scene = run_stage(sfm, SfmParameters(width=1600, matching_size=400), {"capture": made}, tmp_path)["scene"]
    photo = read_picture(picture_path(made, "DSC8003.JPG"))
    picture = scene.read("pictures")[scene.attributes["names"].index("DSC8003.JPG")]
    np.testing.assert_array_equal(picture, photo[:598])
    expected = [[960, 0, 400], [0, 960 * 599 / 600, 599 / 2], [0, 0, 1]]
    np.testing.assert_allclose(scene.read("intrinsics")[0], expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "kitchen").is_dir(), reason="the capture kitchen is not at hand")
@pytest.mark.parametrize(("form", "images"), [("text", "images"), ("binary", "images_2")])
def test_a_model_of_real_photos(form: str, images: str, tmp_path: Path) -> None:
    """The cameras that structure from motion finds for eight photos, as a COLMAP model, give the same scene again."""
    kept = sorted((DATA / "kitchen").iterdir())[:8]
    folder = tmp_path / "kitchen"
    for times, place in ((1, "images"), (2, "images_2")):
        (folder / place).mkdir(parents=True)
        for file in kept:
            picture = read_picture(file)
            size = (picture.shape[1] // times, picture.shape[0] // times)
            (folder / place / f"{file.stem}.JPG").write_bytes(encode_jpeg(cv2.resize(picture, size), 95))
    (tmp_path / "first").mkdir()
    alone = run_stage(photos, PhotosParameters(folder=folder / "images"), {}, tmp_path / "first")["capture"]
    chosen = SfmParameters(width=200, matching_size=800, camera_model="SIMPLE_PINHOLE")
    first = run_stage(sfm, chosen, {"capture": alone}, tmp_path / "first")["scene"]
    names, matrix = list(first.attributes["names"]), first.read("intrinsics")[0]
    full = read_capture(alone).sizes[0]
    pictures = first.read("pictures")
    scale = full[0] / pictures.shape[2]
    camera = ["SIMPLE_PINHOLE", *full, [matrix[0, 0] * scale, full[0] / 2, full[1] / 2]]
    posed = [
        {"name": name, "world_to_camera": pose.tolist(), "camera": camera}
        for name, pose in zip(names, first.read("world_to_camera"), strict=True)
    ]
    write_models(tmp_path, [{"folder": str(folder / "sparse" / "0"), "form": form, "photos": posed}])
    (tmp_path / "again").mkdir()
    given = run_stage(photos, PhotosParameters(folder=folder, images=images), {}, tmp_path / "again")["capture"]
    again = run_stage(sfm, chosen, {"capture": given}, tmp_path / "again")["scene"]
    assert again.attributes["names"] == names
    assert again.attributes["pose_source"] == "colmap"
    np.testing.assert_allclose(again.read("world_to_camera"), first.read("world_to_camera"), atol=1e-9)
    assert again.read("intrinsics")[0, 0, 0] == pytest.approx(matrix[0, 0], rel=0.01)
    assert again.attributes["mean_reprojection_error"] < 1.5
    assert len(again.read("points")) > (0.8 if images == "images" else 0.2) * len(first.read("points"))
