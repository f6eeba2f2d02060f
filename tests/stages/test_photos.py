from __future__ import annotations

import json
import os
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.artifact import Artifact, load
from pipeline.canonical import Json
from pipeline.errors import UserError
from pipeline.stage import Context, Services
from stages.imaging.pictures import read_picture
from stages.photos import PhotosParameters, photos
from stages.scene.capture import picture_path, read_capture
from tests.running import run_stage
from tests.stages.scene.test_colmap import QUATERNION, TRANSLATION, write_binary_model, write_text_model
from tests.stages.scene.test_transforms import MATRIX


def take(
    path: Path,
    size: tuple[int, int] = (64, 48),
    orientation: int | None = None,
    focal: object = None,
    model: str | None = None,
    zoom: float | None = None,
) -> None:
    """A photo of noise with these EXIF data: `focal` is equivalent to 35 mm film, `zoom` is the lens's own."""
    path.parent.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(zlib.crc32(str(path).encode()))
    pixels = generator.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    if focal is not None:
        exif.get_ifd(0x8769)[0xA405] = focal
    if model is not None:
        exif[0x0110] = model
    if zoom is not None:
        exif.get_ifd(0x8769)[0x920A] = zoom
    Image.fromarray(pixels).save(path, exif=exif)


def capture(folder: Path, directory: Path, log: list[str] | None = None, **parameters: object) -> Artifact:
    directory.mkdir(exist_ok=True)
    services = Services(log=(log if log is not None else []).append)
    return run_stage(photos, PhotosParameters(folder=folder, **parameters), {}, directory, services=services)["capture"]


def test_photos_are_kept_as_they_came(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    take(folder / "IMG_2.jpg")
    take(folder / "IMG_10.PNG", size=(32, 20))
    (folder / "notes.txt").write_text("not a photo")
    (folder / "._IMG_2.jpg").write_bytes(b"left behind by another system")
    log: list[str] = []
    artifact = capture(folder, tmp_path / "out", log)
    found = read_capture(artifact)
    assert found.names == ("IMG_10.PNG", "IMG_2.jpg")
    assert found.sizes == ((32, 20), (64, 48))
    assert found.focal_pixels == (None, None)
    assert found.ordered
    assert found.poses is None
    for name in found.names:
        assert picture_path(artifact, name).read_bytes() == (folder / name).read_bytes()
    assert any("2 files" in line for line in log)


def test_copying_is_half_of_the_work(tmp_path: Path) -> None:
    """A stage that reports to be done but works on for minutes seems to hang."""
    for name in "abc":
        take(tmp_path / "photos" / f"{name}.jpg")
    (tmp_path / "out").mkdir()
    said: list[tuple[float, float]] = []
    services = Services(progress=lambda done, total, figures: said.append((done, total)))
    run_stage(photos, PhotosParameters(folder=tmp_path / "photos"), {}, tmp_path / "out", services=services)
    assert said == [(1, 6), (2, 6), (3, 6), (3, 6), (4, 6), (5, 6)]


def test_pictures_that_are_not_read_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **facts: recorded.update(facts))
    take(tmp_path / "photos" / "1.jpg")
    for name in ("2.heic", "notes.txt"):
        (tmp_path / "photos" / name).write_bytes(b"not read")
    capture(tmp_path / "photos", tmp_path / "out")
    assert (recorded["ignored_files"], recorded["unread"]) == (2, {".heic": 1})


def test_photos_of_different_cameras_do_not_share_a_lens(tmp_path: Path) -> None:
    """They are told apart by EXIF's model and zoom, or without these by the folder, as for a camera rig."""
    rig = tmp_path / "rig" / "images"
    for path in ("left/1.jpg", "left/2.jpg", "right/1.jpg"):
        take(rig / path)
    assert read_capture(capture(tmp_path / "rig", tmp_path / "out")).taken_by == (0, 0, 1)
    phone = tmp_path / "phone" / "images"
    for path, model, zoom in (("a/1.jpg", "X", 4.2), ("a/2.jpg", "X", 9), ("b/1.jpg", "X", 4.2), ("b/2.jpg", "Y", 9)):
        take(phone / path, model=model, zoom=zoom)
    assert read_capture(capture(tmp_path / "phone", tmp_path / "phone out")).taken_by == (0, 1, 0, 2)


@pytest.mark.parametrize(
    ("names", "order", "expected"),
    [
        (("f1.png", "f2.png"), "auto", True),
        (("left.png", "right.png"), "auto", False),
        (("left.png", "right.png"), "ordered", True),
        (("f1.png", "f2.png"), "unordered", False),
    ],
)
def test_order(tmp_path: Path, names: tuple[str, ...], order: str, expected: bool) -> None:
    for name in names:
        take(tmp_path / "photos" / name)
    assert read_capture(capture(tmp_path / "photos", tmp_path / "out", order=order)).ordered is expected


def test_photos_in_a_folder_of_their_own_beside_their_poses(tmp_path: Path) -> None:
    for name in ("a.jpg", "b two.jpg", "unposed.jpg"):
        take(tmp_path / "scan" / "images" / name, size=(320, 240))
    write_binary_model(tmp_path / "scan" / "sparse" / "0")
    found = read_capture(capture(tmp_path / "scan", tmp_path / "out"))
    assert found.names == ("a.jpg", "b two.jpg")
    assert found.poses is not None
    assert found.poses.source == "colmap"
    lens = found.poses.lenses[0]
    assert (lens.width, lens.height) == (320, 240)  # the model's camera is for 640 x 480
    assert lens.parameters == (250.0, 255.0, 160.0, 120.0, -0.1, 0.02, 0.001, 0.002)
    np.testing.assert_allclose(found.poses.world_to_camera[0, :3, 3], TRANSLATION)
    assert np.linalg.norm(QUATERNION) == 1


def write_transforms(folder: Path, *names: str) -> None:
    frames = [{"file_path": f"images/{name}", "transform_matrix": MATRIX} for name in names]
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))


def test_poses_of_photos_in_several_folders(tmp_path: Path) -> None:
    for path in ("images/left/1.jpg", "images/right/1.jpg"):
        take(tmp_path / "rig" / path)
    write_transforms(tmp_path / "rig", "right/1.jpg")
    content = json.loads((tmp_path / "rig" / "transforms.json").read_text())
    held_out = {**content, "test_filenames": ["images/right/1.jpg"]}
    (tmp_path / "rig" / "transforms.json").write_text(json.dumps(held_out))
    artifact = capture(tmp_path / "rig", tmp_path / "out")
    assert read_capture(artifact).names == ("right_1.jpg",)
    assert artifact.attributes["test_names"] == ["right_1.jpg"]
    write_transforms(tmp_path / "rig", "middle/1.jpg")
    expect_refusal(tmp_path / "rig", tmp_path / "other", "do not exist", "middle/1.jpg")


def test_poses_in_coordinates_of_a_map_are_refused(tmp_path: Path) -> None:
    frames = []
    for name, along in (("a.jpg", 0.0), ("b.jpg", 20.0)):
        take(tmp_path / "survey" / name)
        matrix = [[1.0, 0, 0, 500123.0 + along], [0, 1.0, 0, 5400321.0], [0, 0, 1.0, 300.0], [0, 0, 0, 1.0]]
        frames.append({"file_path": name, "transform_matrix": matrix})
    (tmp_path / "survey" / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    expect_refusal(tmp_path / "survey", tmp_path / "out", "transforms.json", "too far", "500133, 5400321, 300")


@pytest.mark.parametrize("name", ["a", "a.jpg", "a.png"], ids=["no extension", "the photo's", "another"])
def test_poses_of_a_transforms_file(tmp_path: Path, name: str) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path / "photos", name)
    found = read_capture(capture(tmp_path / "photos", tmp_path / "out"))
    assert found.poses is not None
    assert found.poses.source == "transforms"
    assert found.poses.lenses[0].matrix()[0, 0] == pytest.approx(32 / np.tan(0.5))


def test_poses_may_lie_elsewhere(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path, "a.jpg")
    assert read_capture(capture(tmp_path / "photos", tmp_path / "without")).poses is None
    given = capture(tmp_path / "photos", tmp_path / "with", poses=tmp_path / "transforms.json")
    assert read_capture(given).poses is not None


def test_poses_elsewhere_in_the_folder_of_a_capture(tmp_path: Path) -> None:
    for name in ("a.jpg", "b two.jpg"):
        take(tmp_path / "photos" / name, size=(320, 240))
    write_binary_model(tmp_path / "posed" / "sparse" / "0")
    found = read_capture(capture(tmp_path / "photos", tmp_path / "out", poses=tmp_path / "posed"))
    assert found.poses is not None
    assert found.poses.source == "colmap"
    expect_refusal(tmp_path / "photos", tmp_path / "none", "without poses", "(.jpg)", poses=tmp_path / "photos")


def test_a_photo_is_matched_by_its_whole_name_before_its_stem(tmp_path: Path) -> None:
    for name in ("a.jpg", "a.1.jpg"):
        take(tmp_path / "photos" / name)
    write_transforms(tmp_path / "photos", "a.1")
    assert read_capture(capture(tmp_path / "photos", tmp_path / "out")).names == ("a.1.jpg",)


@pytest.mark.parametrize("kind", ["frames", "test_filenames", "model"])
def test_paths_that_no_photo_can_have_are_refused(tmp_path: Path, kind: str) -> None:
    """Without doing anything with them, and naming no more than their beginning."""
    folder, endless = tmp_path / "photos", "d/" * 10_000 + "a.jpg"
    take(folder / "a.jpg", size=(320, 240))
    write_transforms(folder, endless if kind == "frames" else "a.jpg")
    if kind == "test_filenames":
        content = json.loads((folder / "transforms.json").read_text()) | {"test_filenames": [endless]}
        (folder / "transforms.json").write_text(json.dumps(content))
    if kind == "model":
        write_text_model(folder / "sparse")
        images = folder / "sparse" / "images.txt"
        images.write_text(images.read_text().replace("a.jpg", endless))
    source = "sparse" if kind == "model" else "transforms.json"
    expect_refusal(folder, tmp_path / "out", source, "too long", "at most 4096 characters")


def expect_refusal(folder: Path, directory: Path, *words: str, **parameters: object) -> None:
    with pytest.raises(UserError) as raised:
        capture(folder, directory, **parameters)
    assert all(word in str(raised.value) for word in words), str(raised.value)


def test_a_folder_without_photos_is_refused_with_what_is_there(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    expect_refusal(folder, tmp_path / "first", "no such folder")
    folder.mkdir()
    expect_refusal(folder, tmp_path / "second", "without photos", "an empty folder")
    (folder / "a.heic").write_bytes(b"1")
    (folder / "more").mkdir()
    expect_refusal(folder, tmp_path / "third", "1 file (.heic)", "folder more")


@pytest.mark.parametrize("kept", [0, 100, -5])
def test_a_damaged_photo_is_named(tmp_path: Path, kept: int) -> None:
    take(tmp_path / "photos" / "a.jpg", size=(300, 200))
    take(tmp_path / "photos" / "broken.jpg", size=(300, 200))
    broken = tmp_path / "photos" / "broken.jpg"
    broken.write_bytes(broken.read_bytes()[: kept if kept >= 0 else broken.stat().st_size // 2])
    expect_refusal(tmp_path / "photos", tmp_path / "out", "broken.jpg")


@pytest.mark.parametrize("stated", ["50mm", (50, 50), float("inf"), -35, 0])
def test_a_focal_length_that_is_none_counts_as_unknown(tmp_path: Path, stated: object) -> None:
    take(tmp_path / "photos" / "a.jpg", focal=stated)
    assert read_capture(capture(tmp_path / "photos", tmp_path / "out")).focal_pixels == (None,)


@pytest.mark.parametrize("name", [b"caf\xe9.jpg", b"two\nlines.jpg"])
def test_names_that_tables_cannot_hold_are_refused(tmp_path: Path, name: bytes) -> None:
    take(tmp_path / "photos" / "a.jpg")
    (tmp_path / "photos" / "a.jpg").rename(tmp_path / "photos" / os.fsdecode(name))
    expect_refusal(tmp_path / "photos", tmp_path / "out", "name of a photo", ascii(os.fsdecode(name)))


@pytest.mark.parametrize(
    "path",
    [
        f"images/{'a' * 150}/{'b' * 140}.jpg",
        f"images/{'a' * 200}/{'b' * 200}.jpg",
        f"images/{'花' * 60}/{'花' * 60}.jpg",
        "images/a\\b.jpg",
    ],
)
def test_names_that_no_file_can_have_are_refused(tmp_path: Path, path: str) -> None:
    take(tmp_path / "photos" / path)
    expect_refusal(tmp_path / "photos", tmp_path / "out", "no file can have the name", "or its folder")


def test_spaces_of_all_widths_are_kept_in_names(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "Screenshot 3.45\u202fPM.png")
    assert read_capture(capture(tmp_path / "photos", tmp_path / "out")).names == ("Screenshot 3.45\u202fPM.png",)


def test_photos_that_only_extensions_tell_apart_are_refused(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "same.jpg")
    take(tmp_path / "photos" / "same.png")
    expect_refusal(tmp_path / "photos", tmp_path / "out", "same.jpg and same.png")


def test_poses_for_other_photos_are_refused(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path / "photos", "a.jpg", "missing.jpg")
    expect_refusal(tmp_path / "photos", tmp_path / "out", "do not exist", "missing.jpg", "1 of 2")


def test_a_photo_posed_twice_is_refused(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path / "photos", "a.jpg", "a.png")
    expect_refusal(tmp_path / "photos", tmp_path / "out", "posed twice", "a.jpg")


def test_no_poses_in_a_file_of_poses_is_refused(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path / "photos")
    expect_refusal(tmp_path / "photos", tmp_path / "out", "without poses")


def test_poses_of_a_cropped_photo_are_refused(tmp_path: Path) -> None:
    for name in ("a.jpg", "b two.jpg"):
        take(tmp_path / "photos" / name, size=(320, 320))
    write_binary_model(tmp_path / "photos")
    expect_refusal(tmp_path / "photos", tmp_path / "out", "another shape", "640 x 480")


def test_only_what_is_transparent_is_laid_over_another_background(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    take(folder / "opaque.jpg")
    rendered = np.zeros((48, 64, 4), np.uint8)
    rendered[:, :32] = [200, 100, 0, 255]
    rendered[:, 32:48] = [200, 100, 0, 51]  # a fifth
    Image.fromarray(rendered).save(folder / "rendered.png")
    Image.fromarray(rendered | np.array([0, 0, 0, 255], np.uint8)).save(folder / "solid.png")
    shown = {}
    for color in ("white", "black", "#0a1e32"):
        artifact = capture(folder, tmp_path / color, background=color)
        shown[color] = read_picture(picture_path(artifact, "rendered.png"))[0, [0, 40, 63]].tolist()
        for name in ("opaque.jpg", "solid.png"):
            assert picture_path(artifact, name).read_bytes() == (folder / name).read_bytes()
    assert shown["white"] == [[200, 100, 0], [244, 224, 204], [255, 255, 255]]
    assert shown["black"] == [[200, 100, 0], [40, 20, 0], [0, 0, 0]]
    assert shown["#0a1e32"] == [[200, 100, 0], [48, 44, 40], [10, 30, 50]]
    assert capture(folder, tmp_path / "out").digest == load(tmp_path / "black" / "capture").digest, "as renders are"
    with pytest.raises(ValueError, match="background"):
        PhotosParameters(folder=folder, background="url(x)")


@pytest.mark.parametrize(("background", "first"), [("white", 255), ("black", 0)])
def test_a_grey_that_a_picture_of_16_bits_calls_transparent(tmp_path: Path, background: str, first: int) -> None:
    (tmp_path / "photos").mkdir()
    greys = Image.fromarray(np.array([[0, 65535, 30000, 1000]], np.uint16))
    greys.save(tmp_path / "photos" / "grey.png", transparency=0)
    artifact = capture(tmp_path / "photos", tmp_path / "out", background=background)
    shown = read_picture(picture_path(artifact, "grey.png"))
    assert shown[0, :, 0].tolist() == [first, 255, 117, 4]


def test_frames_that_nerfstudio_holds_out(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg"):
        take(tmp_path / "scan" / "images" / name)
    write_transforms(tmp_path / "scan", "a.jpg", "b.jpg")
    whole = json.loads((tmp_path / "scan" / "transforms.json").read_text())
    assert "test_names" not in capture(tmp_path / "scan", tmp_path / "first").attributes
    for listed in ("images/b.jpg", "images/b"):
        split = {"train_filenames": ["images/a.jpg"], "test_filenames": [listed]}
        (tmp_path / "scan" / "transforms.json").write_text(json.dumps(whole | split))
        artifact = capture(tmp_path / "scan", tmp_path / f"of {Path(listed).name}")
        assert artifact.attributes["test_names"] == ["b.jpg"]


def test_intrinsics_in_pixels_of_resized_photos(tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    take(folder / "images_2" / "a.jpg", size=(64, 48))
    frames = [{"file_path": "images/a.jpg", "transform_matrix": MATRIX}]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 100, "frames": frames}))
    with pytest.raises(UserError, match="w and h are missing"):
        capture(folder, tmp_path / "first", images="images_2")
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 100, "w": 128, "h": 96, "frames": frames}))
    found = read_capture(capture(folder, tmp_path / "second", images="images_2"))
    assert found.poses is not None
    assert found.poses.lenses[0].parameters[:4] == (50, 50, 32, 24)


def test_sizes_that_no_photo_has_are_refused(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg")
    write_transforms(tmp_path / "photos", "a.jpg")
    content = json.loads((tmp_path / "photos" / "transforms.json").read_text()) | {"w": 10**400, "h": 1, "fl_x": 1.0}
    (tmp_path / "photos" / "transforms.json").write_text(json.dumps(content))
    expect_refusal(tmp_path / "photos", tmp_path / "out", "transforms.json")
