"""Photos in folders beside those used are reported if they may belong to the capture, and only then."""

from __future__ import annotations

from pathlib import Path

import pytest

from stages.scene.photo_folder import find_photos
from tests.stages.test_photos import capture, take


def scan(folder: Path, *paths: str) -> Path:
    for path in paths:
        take(folder / path, size=(8, 6))
    return folder


@pytest.mark.parametrize("place", [".", "images"])
def test_fewer_photos_in_a_folder_beside_the_others_are_told(tmp_path: Path, place: str) -> None:
    folder = scan(tmp_path / "scan", *(f"{place}/{number}.jpg" for number in range(4)), "more photos/day 2/7.jpg")
    log: list[str] = []
    assert capture(folder, tmp_path / "out", log).attributes["names"] == ["0.jpg", "1.jpg", "2.jpg", "3.jpg"]
    assert "1 photo is in folders beside those used and was left out: in more photos/day 2" in log


@pytest.mark.parametrize(
    "other",
    [
        *("images_4/9.jpg", "masks/9.png", "mono_depth/9.png", "Thumbnails/9.jpg", "@eaDir/9.jpg", ".hidden/9.jpg"),
        *("sparse/deep/9.png", "small/0.PNG", "more/.9.jpg", "more/notes.txt"),
    ],
)
def test_what_is_no_photo_of_the_capture_is_not(tmp_path: Path, other: str) -> None:
    """Nor is a folder with exactly the names of the photos, whatever it is called."""
    folder = scan(tmp_path / "scan", "images/0.jpg")
    if Path(other).suffix == ".txt":
        (folder / other).parent.mkdir()
        (folder / other).write_text("no photo")
    else:
        scan(folder, other)
    assert find_photos(folder).below == ()


def test_originals_beside_what_was_undistorted_of_some_are_not(tmp_path: Path) -> None:
    folder = scan(tmp_path / "scan", "images/0.jpg", "input/0.jpg", "input/1.jpg")
    assert find_photos(folder).below == ()
    assert find_photos(scan(folder, "again/0.jpg", "again/1.jpg")).below == (
        folder / "again/0.jpg",
        folder / "again/1.jpg",
    )


def test_where_one_folder_is_named_those_beside_it_are_not(tmp_path: Path) -> None:
    folder = scan(tmp_path / "rig", "left/0.jpg", "right/1.jpg", "left/far/2.jpg")
    assert find_photos(folder, "left").below == (folder / "left/far/2.jpg",)


def test_links_that_lead_back_up_are_followed_once(tmp_path: Path) -> None:
    folder = scan(tmp_path / "scan", "0.jpg", "more/1.jpg")
    for name in ("back", "again"):
        (folder / "more" / name).symlink_to(folder)
    assert find_photos(folder).below == (folder / "more/1.jpg",)
