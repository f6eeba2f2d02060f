"""Photos that a transforms.json names by paths: in a folder of any name, and undistorted ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact
from pipeline.canonical import Json
from pipeline.stage import Context
from stages.scene.capture import picture_path, read_capture
from tests.stages.scene.test_colmap import write_text_model
from tests.stages.scene.test_transforms import MATRIX, write
from tests.stages.test_photos import capture, take


def posed(folder: Path, *paths: str, **shared: object) -> None:
    """Write a file of poses for photos of 64 x 48 pixels at these paths."""
    frames: list[dict] = [{"file_path": path, "transform_matrix": MATRIX} for path in paths]
    write(folder, frames, fl_x=60, w=64, h=48, **shared)


def bytes_of(made: Artifact) -> list[bytes]:
    return [picture_path(made, name).read_bytes() for name in read_capture(made).names]


@pytest.mark.parametrize("suffix", ["", ".png"])
def test_photos_lie_where_the_frames_say(tmp_path: Path, suffix: str) -> None:
    for name in ("1.png", "2.png"):
        take(tmp_path / "scan" / "frames" / name)
    posed(tmp_path / "scan", f"./frames/1{suffix}", f"frames/2{suffix}")
    assert read_capture(capture(tmp_path / "scan", tmp_path / "out")).names == ("1.png", "2.png")


@pytest.mark.parametrize("file", ["transforms.json", "transforms_train.json"])
@pytest.mark.parametrize(
    ("frame", "photo"),
    [
        (r"train\1.png", "train/1.png"),
        (r".\train\1", "train/1.png"),
        ("train/1", "train/1.PNG"),
        ("train/cafe\N{COMBINING ACUTE ACCENT}.png", "train/caf\N{LATIN SMALL LETTER E WITH ACUTE}.png"),
        ("train/caf\N{LATIN SMALL LETTER E WITH ACUTE}.png", "train/cafe\N{COMBINING ACUTE ACCENT}.png"),
    ],
    ids=["windows", "windows, no extension", "capitals", "composed on the disk", "decomposed on the disk"],
)
def test_paths_as_other_systems_write_them(tmp_path: Path, file: str, frame: str, photo: str) -> None:
    take(tmp_path / "scan" / photo)
    posed(tmp_path / "scan", frame)
    (tmp_path / "scan" / "transforms.json").rename(tmp_path / "scan" / file)
    found = read_capture(capture(tmp_path / "scan", tmp_path / "out"))
    before = "train_" if "train" in file else ""
    assert found.names == (before + Path(photo).name,)
    assert found.poses is not None


def test_undistorted_photos_come_before_the_originals_of_the_same_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **facts: recorded.update(facts))
    scan = tmp_path / "scan"
    for name in ("1.jpg", "2.jpg"):
        take(scan / "images" / name, size=(640, 480))
        take(scan / "undistorted" / name)
    posed(scan, "undistorted/1.jpg", "undistorted/2.jpg")
    made = capture(scan, tmp_path / "out")
    assert read_capture(made).sizes == ((64, 48), (64, 48))
    assert bytes_of(made) == [(scan / "undistorted" / name).read_bytes() for name in ("1.jpg", "2.jpg")]
    assert recorded["left_out"] == 2


@pytest.mark.parametrize(("thrown_away", "first"), [(1, "undistorted"), (2, "images")])
def test_an_undistorted_photo_that_was_thrown_away_is_not_replaced_by_its_original(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thrown_away: int, first: str
) -> None:
    """Only if many are missing are the named photos other ones, as of another machine."""
    recorded: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **facts: recorded.update(facts))
    scan, names = tmp_path / "scan", [f"{number}.jpg" for number in range(5)]
    for name in names:
        take(scan / "images" / name)
        take(scan / "undistorted" / name)
    posed(scan, *(f"undistorted/{name}" for name in names))
    for name in names[1 : 1 + thrown_away]:
        (scan / "undistorted" / name).unlink()
    made = capture(scan, tmp_path / "out")
    kept = [name for name in names if (scan / first / name).exists()]
    assert bytes_of(made) == [(scan / first / name).read_bytes() for name in kept]
    assert recorded["without_photo"] == len(names) - len(kept)


def test_photos_elsewhere_than_the_frames_say_are_found_by_their_names(tmp_path: Path) -> None:
    """For instance if the file was written on another machine, or names only some of the photos."""
    scan = tmp_path / "scan"
    for name in ("1.jpg", "2.jpg", "3.jpg"):
        take(scan / "images" / name)
    posed(scan, "/elsewhere/1.jpg", "../2.jpg")
    assert read_capture(capture(scan, tmp_path / "elsewhere")).names == ("1.jpg", "2.jpg")
    posed(scan, "images/1.jpg", "images/3.jpg")
    assert read_capture(capture(scan, tmp_path / "some")).names == ("1.jpg", "3.jpg")


def test_the_parameter_images_wins(tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    take(scan / "frames" / "1.jpg", size=(640, 480))
    take(scan / "frames_10" / "1.jpg")
    posed(scan, "frames/1.jpg")
    assert read_capture(capture(scan, tmp_path / "out", images="frames_10")).sizes == ((64, 48),)


@pytest.mark.parametrize("file", ["transforms.json", "transforms_train.json"])
@pytest.mark.parametrize("beside_a_model", [False, True])
def test_masks_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, beside_a_model: bool) -> None:
    recorded: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **facts: recorded.update(facts))
    scan = tmp_path / "scan"
    for name in ("a.jpg", "b two.jpg"):
        take(scan / "images" / name, size=(640, 480))
    if beside_a_model:
        write_text_model(scan / "colmap" / "sparse" / "0")
    masked: dict = {"file_path": "images/a.jpg", "transform_matrix": MATRIX, "mask_path": "masks/a.png"}
    write(scan, [masked], fl_x=600, w=640, h=480)
    (scan / "transforms.json").rename(scan / file)
    capture(scan, tmp_path / "out")
    read = not beside_a_model or file == "transforms.json"  # no split is read beside a model
    assert recorded["masked"] == int(read)


def test_the_split_beside_a_model_counts(tmp_path: Path) -> None:
    """nerfstudio leaves a transforms.json beside the model."""
    scan = tmp_path / "scan"
    write_text_model(scan / "colmap" / "sparse" / "0")
    for name in ("a.jpg", "b two.jpg"):
        take(scan / "images" / name, size=(640, 480))
    posed(scan, "images/a.jpg", "images/b two.jpg", test_filenames=["images/a.jpg"])
    made = capture(scan, tmp_path / "out")
    assert made.attributes["poses"] == "colmap"
    assert made.attributes["test_names"] == ["a.jpg"]
