"""Photos that a capture holds out for testing, by a list beside its poses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.stages.scene.test_colmap import write_text_model
from tests.stages.scene.test_transforms import MATRIX, write
from tests.stages.test_photos import capture, expect_refusal, take

PHOTOS = ("a.jpg", "b two.jpg")
"""The photos that the model poses."""


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A capture with a COLMAP model, and a photo that the model could not pose."""
    folder = tmp_path / "scan"
    for name in (*PHOTOS, "unposed.jpg"):
        take(folder / "images" / name, size=(640, 480))
    write_text_model(folder / "sparse" / "0")
    return folder


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
def test_a_list_of_test_photos_beside_a_model_counts(scan: Path, place: str, tmp_path: Path) -> None:
    """3DGS reads it in sparse/0. A photo without a pose is neither a test view nor trained on."""
    (scan / place / "test.txt").write_text("\nb two.jpg\r\n\nunposed.jpg\n")
    assert capture(scan, tmp_path / "out").attributes["test_names"] == ["b two.jpg"]


def test_a_list_beside_a_model_that_is_elsewhere_counts(scan: Path, tmp_path: Path) -> None:
    (scan / "images").rename(tmp_path / "photos")
    (scan / "test.txt").write_text("a.jpg\n")
    assert capture(tmp_path / "photos", tmp_path / "out", poses=scan).attributes["test_names"] == ["a.jpg"]


@pytest.mark.parametrize("beside", [{}, {"frames": []}], ids=["no frames", "frames"])
def test_test_filenames_beside_a_model_need_no_frames(scan: Path, beside: dict, tmp_path: Path) -> None:
    (scan / "transforms.json").write_text(json.dumps({**beside, "test_filenames": ["images/a.jpg"]}))
    assert capture(scan, tmp_path / "out").attributes["test_names"] == ["a.jpg"]


def test_what_any_list_holds_out_is_held_out(scan: Path, tmp_path: Path) -> None:
    (scan / "transforms.json").write_text(json.dumps({"test_filenames": ["images/a.jpg"]}))
    (scan / "sparse" / "0" / "test.txt").write_text("b two.jpg\n")
    assert capture(scan, tmp_path / "out").attributes["test_names"] == ["a.jpg", "b two.jpg"]


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("transforms.json", json.dumps({"frames": [], "test_filenames": ["images/a.jpg", "images/other.jpg"]})),
        ("sparse/0/test.txt", "a.jpg\nother.jpg\n"),
    ],
)
def test_names_of_no_photo_are_refused(scan: Path, file: str, content: str, tmp_path: Path) -> None:
    (scan / file).write_text(content)
    expect_refusal(scan, tmp_path / "out", file, "do not exist", "1 of 2", "other.jpg", "3 photos, such as a.jpg")


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("transforms.json", b"no JSON", "cannot be read"),
        ("transforms.json", b"[1]", "found [1], which is no object"),
        ("transforms.json", b'{"test_filenames": "images/a.jpg"}', 'found test_filenames: "images/a.jpg"'),
        ("transforms.json", b'{"test_filenames": ["images/a.jpg", 2]}', 'found test_filenames: ["images/a.jpg", 2]'),
        ("sparse/0/test.txt", b"caf\xe9.jpg\n", "a list of test photos cannot be read"),
    ],
)
def test_a_list_that_cannot_be_read_is_refused(
    scan: Path, file: str, content: bytes, said: str, tmp_path: Path
) -> None:
    (scan / file).write_bytes(content)
    expect_refusal(scan, tmp_path / "out", file, said, "take it out of the f")


def test_a_posed_photo_that_was_thrown_away_may_be_held_out(tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    paths = [f"images/left/{number}.jpg" for number in range(4)]
    for path in paths[1:]:
        take(folder / path)
    frames = [{"file_path": path, "transform_matrix": MATRIX} for path in paths]
    write(folder, frames, fl_x=60, w=64, h=48, test_filenames=paths[:2])
    made = capture(folder, tmp_path / "out")
    assert made.attributes["test_names"] == [name for name in made.attributes["names"] if "1" in name]
