"""Which photos of a folder are the capture: those in it, in `images`, or in the folders of a rig's cameras."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.scene.capture import picture_path, read_capture
from stages.scene.photo_folder import find_photos
from stages.scene.unreadable import unreadable_names
from tests.stages.test_photos import capture, expect_refusal, take


def test_photos_in_folders_below_images_are_taken_with_the_folders_in_their_names(tmp_path: Path) -> None:
    """Folders as a rig's cameras or phones make them; what is beside `images` or hidden is left out."""
    for path in ("images/left/0001.jpg", "images/left/0002.jpg", "images/right/far/0001.jpg"):
        take(tmp_path / "rig" / path)
    for path in ("masks/0001.png", "images/.thumbnails/0001.jpg", "left/0003.jpg"):
        take(tmp_path / "rig" / path)
    artifact = capture(tmp_path / "rig", tmp_path / "out")
    assert read_capture(artifact).names == ("left_0001.jpg", "left_0002.jpg", "right_far_0001.jpg")
    far = tmp_path / "rig" / "images" / "right" / "far" / "0001.jpg"
    assert picture_path(artifact, "right_far_0001.jpg").read_bytes() == far.read_bytes()
    alone = capture(tmp_path / "rig", tmp_path / "alone", images="left")
    assert read_capture(alone).names == ("0003.jpg",)


def test_masks_and_thumbnails_among_the_folders_of_a_rig_are_no_photos(tmp_path: Path) -> None:
    """Programs and network drives leave them in every camera's folder."""
    derived = ("left/masks/0001.png", "right/masks/0001.png", "left/@eaDir/0001.jpg/THUMB_M.jpg")
    for path in ("left/0001.jpg", "right/0001.jpg", *derived):
        take(tmp_path / "rig" / "images" / path)
    found = find_photos(tmp_path / "rig")
    assert [*found.photos] == ["left_0001.jpg", "right_0001.jpg"]
    assert found.ignored == len(derived)


def test_a_camera_called_like_what_is_derived_is_taken_if_it_is_the_only_one(tmp_path: Path) -> None:
    take(tmp_path / "rig" / "images" / "depth camera" / "0001.jpg")
    assert [*find_photos(tmp_path / "rig").photos] == ["depth camera_0001.jpg"]


def test_folders_beside_photos_are_left_alone(tmp_path: Path) -> None:
    """They may hold depths, masks or other sizes."""
    for path in ("images/a.jpg", "images/small/a.jpg"):
        take(tmp_path / "scan" / path)
    assert read_capture(capture(tmp_path / "scan", tmp_path / "out")).names == ("a.jpg",)
    assert find_photos(tmp_path / "scan").below == ()


@pytest.mark.parametrize("place", ["rig/images", "rig"])
def test_strays_beside_the_folders_of_a_rig_do_not_hide_it(tmp_path: Path, place: str) -> None:
    for path in ("stray.jpg", "left/1.jpg", "left/2.jpg", "right/1.jpg", ".hidden/1.jpg"):
        take(tmp_path / place / path)
    found = find_photos(tmp_path / "rig")
    assert ([*found.photos], len(found.below)) == (["stray.jpg"], 3)


@pytest.mark.parametrize(
    ("beside", "inside", "expected"),
    [(1, 3, "inside"), (3, 1, "beside"), (2, 2, "beside"), (0, 1, "inside")],
)
def test_a_preview_beside_the_photos_is_not_the_capture(
    tmp_path: Path, beside: int, inside: int, expected: str
) -> None:
    counts = {"beside": beside, "inside": inside}
    for place, folder in (("beside", tmp_path / "scan"), ("inside", tmp_path / "scan" / "images")):
        for number in range(counts[place]):
            take(folder / f"{place}{number}.jpg")
    names = read_capture(capture(tmp_path / "scan", tmp_path / "out")).names
    assert names == tuple(f"{expected}{number}.jpg" for number in range(counts[expected]))
    assert len(find_photos(tmp_path / "scan").left_out) == sum(counts.values()) - counts[expected]


def test_of_any_pictures_it_is_said_how_many_files_were_not_looked_at(tmp_path: Path) -> None:
    """In a capture's folder, GIFs are not photos, and files in subfolders are not reported."""
    for path in ("a.png", "d.gif", "g.jfif", "h.png", "site/b.png", "site/deep/c.png", ".hidden/h.png"):
        take(tmp_path / "found" / path)
    for name in ("e.avif", "f.heic", ".DS_Store"):
        (tmp_path / "found" / name).write_bytes(b"nothing that is read")
    log: list[str] = []
    looked_at = capture(tmp_path / "found", tmp_path / "out", log, any_pictures=True)
    assert read_capture(looked_at).names == ("a.png", "d.gif", "g.jfif", "h.png")
    assert "4 files in the folder and its subfolders were not looked at, such as " + ", ".join(
        ("e.avif", "f.heic", "site/b.png", "site/deep/c.png")
    ) in "".join(log)
    assert read_capture(capture(tmp_path / "found", tmp_path / "photos", log)).names == ("a.png", "g.jfif", "h.png")
    assert sum("not looked at" in line for line in log) == 1


def test_of_any_pictures_those_directly_in_the_folder_are_looked_at_whatever_lies_beside_them(tmp_path: Path) -> None:
    """A folder `images` with more pictures, files of poses and one picture in two formats make no difference."""
    found = tmp_path / "found"
    for path in ("a.png", "a.jpg", "b.png", "images/1.png", "images/2.png", "images/3.png", "images/4.png"):
        take(found / path, size=(64, 64))
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), "fl_x": 60.0}
    for name in ("transforms.json", "transforms_train.json"):
        (found / name).write_text(json.dumps({"frames": [frame]}))
    read = read_capture(capture(found, tmp_path / "out", any_pictures=True))
    assert read.names == ("a.jpg", "a.png", "b.png")
    assert read.poses is None


def test_photos_that_folders_give_the_same_name_are_refused(tmp_path: Path) -> None:
    for path in ("images/left_far/1.jpg", "images/left/far_1.jpg"):
        take(tmp_path / "rig" / path)
    expect_refusal(tmp_path / "rig", tmp_path / "out", "left_far_1.jpg", "left/far_1.jpg and left_far/1.jpg")


def test_a_folder_of_folders_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """Nothing says which of them hold photos of the capture, and which masks or other sizes."""
    take(tmp_path / "rig" / "left" / "1.jpg")
    expect_refusal(tmp_path / "rig", tmp_path / "out", "folder left", "in one called images", "parameter images")


@pytest.mark.parametrize("place", ["", "images/left"])
def test_pictures_that_are_not_read_are_counted_apart(tmp_path: Path, place: str) -> None:
    """Not counted are raw files that a camera wrote beside its photos, and what operating systems leave behind."""
    folder = tmp_path / "photos" / place
    for name in ("1.jpg", "2.jpg", "3.jpg"):
        take(folder / name)
    others = ("4.HEIC", "5.heic", "6.dng", "1.dng", "._4.HEIC", "Thumbs.db", ".DS_Store")
    for name in others:
        (folder / name).write_bytes(b"not read")
    found = find_photos(tmp_path / "photos")
    assert len(found.photos) == 3
    assert found.ignored == len(others)
    assert found.unread == {".dng": 1, ".heic": 2}


def test_a_folder_of_which_most_pictures_are_not_read_is_refused(tmp_path: Path) -> None:
    """A phone writes HEIC, and now and then a JPEG: these few are not the capture."""
    folder = tmp_path / "photos"
    for name in ("1.jpg", "2.jpg"):
        take(folder / name)
    for name in ("3.HEIC", "4.heic"):
        (folder / name).write_bytes(b"not read")
    assert len(capture(folder, tmp_path / "half").files) > 0
    (folder / "5.dng").write_bytes(b"not read")
    with pytest.raises(UserError, match=r"cannot be read; found 1 \.dng, 2 \.heic, beside 2 that can.*Convert"):
        capture(folder, tmp_path / "most")


def test_photos_that_cannot_be_read_are_named_together(tmp_path: Path) -> None:
    """Messengers send dozens of HEIC files named as JPEG: naming one at a time would take dozens of runs."""
    folder = tmp_path / "photos"
    take(folder / "1.jpg")
    for number in range(2, 15):
        (folder / f"{number}.jpg").write_bytes(b"not a JPEG")
    with pytest.raises(UserError, match=r"photos: 13 pictures cannot be read; found 10\.jpg, 11\.jpg, .*, …; of the"):
        capture(folder, tmp_path / "out")


def test_of_any_pictures_one_that_cannot_be_read_stands_in_no_others_way(tmp_path: Path) -> None:
    """Strangers made them. In a capture the picture would be missed: there it is an error, and also if none is left."""
    folder = tmp_path / "found"
    for name in ("1.png", "2.jpg", "4.gif"):
        take(folder / name, size=(64, 48))
    whole = (folder / "2.jpg").read_bytes()
    (folder / "2.jpg").write_bytes(whole[: len(whole) // 2])
    (folder / "3.jpg").write_bytes(b"not a JPEG")
    log: list[str] = []
    found = capture(folder, tmp_path / "out", log, any_pictures=True)
    assert read_capture(found).names == ("1.png", "4.gif")
    assert unreadable_names(found) == ("2.jpg", "3.jpg")
    for name in ("2.jpg", "3.jpg"):
        assert any(line.startswith(f"{name} is left out") and "cannot be read" in line for line in log)
    with pytest.raises(UserError, match="2 pictures cannot be read"):
        capture(folder, tmp_path / "photos")
    for name in ("1.png", "4.gif"):
        (folder / name).unlink()
    with pytest.raises(UserError, match="2 pictures cannot be read"):
        capture(folder, tmp_path / "none", any_pictures=True)
    (folder / "3.jpg").unlink()
    take(folder / "2.jpg")
    assert unreadable_names(capture(folder, tmp_path / "repaired", any_pictures=True)) == ()


def test_a_folder_of_pictures_that_are_not_read_is_refused_with_what_to_do(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "1.HEIC").write_bytes(b"not read")
    with pytest.raises(UserError) as raised:
        find_photos(folder)
    assert raised.value.remedy == "Convert the pictures (.heic), which cannot be read, to JPEG."
    take(folder / "left" / "1.jpg")
    expect_refusal(folder, tmp_path / "out", "Convert the pictures (.heic)", "cameras of a rig")
    (folder / "1.HEIC").rename(folder / "left" / "2.HEIC")
    with pytest.raises(UserError) as raised:
        find_photos(folder)
    assert str(raised.value.remedy).startswith("Those of several folders")


def test_copies_of_a_photo_are_left_out_where_no_poses_came(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    for name in ("a.jpg", "b.jpg", "c.png"):
        take(folder / name)
    for name, source in (("a (1).jpg", "a.jpg"), ("z.jpg", "a.jpg"), ("d.png", "c.png")):
        (folder / name).write_bytes((folder / source).read_bytes())
    log: list[str] = []
    assert read_capture(capture(folder, tmp_path / "out", log)).names == ("a (1).jpg", "b.jpg", "c.png")
    assert any("3 photos are exact copies of others" in line and "a.jpg, d.png, z.jpg" in line for line in log)
    every = read_capture(capture(folder, tmp_path / "all", any_pictures=True))
    assert len(every.names) == 6, "who looks through pictures is answered for each"


def test_links_that_lead_round_in_a_circle_end(tmp_path: Path) -> None:
    """Two such links could be followed without end; a folder that is also linked to is taken by its own name."""
    take(tmp_path / "rig" / "images" / "right" / "1.jpg")
    for name, leads_to in (("a", "images"), ("b", "images"), ("left", "images/right")):
        (tmp_path / "rig" / "images" / name).symlink_to(tmp_path / "rig" / leads_to)
    assert [*find_photos(tmp_path / "rig").photos] == ["right_1.jpg"]
