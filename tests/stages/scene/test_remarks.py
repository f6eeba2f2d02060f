"""Remarks on captures and scenes when nothing failed and yet something is amiss."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.stage import Finished, Remark
from stages.scene.remarks import message_hardly_seen, photos_left_out, photos_missing_or_cropped


def artifact(path: Path, kind: str, **attributes: Json) -> Artifact:
    with create(path, kind) as writer:
        writer.attributes |= attributes
        writer.write_file("note.txt", "something")
    return load(path)


def finished(inputs: Mapping[str, Artifact], outputs: Mapping[str, Artifact], **facts: Json) -> Finished:
    return Finished(inputs, outputs, facts)


def test_photos_that_structure_from_motion_could_not_place(tmp_path: Path) -> None:
    capture = artifact(tmp_path / "capture", "capture", names=["a.jpg", "b.jpg", "c.jpg"])
    scene = artifact(tmp_path / "scene", "scene", names=["b.jpg"])
    (remark,) = photos_missing_or_cropped(finished({"capture": capture}, {"scene": scene}))
    assert remark.text.startswith("1 of 3 photos placed;")
    assert not remark.as_wished
    assert ".jpg" not in remark.text
    assert remark.details == "Not placed: a.jpg, c.jpg"


def test_photos_that_no_lens_took(tmp_path: Path) -> None:
    """More overlap would not place them."""
    capture = artifact(tmp_path / "capture", "capture", names=["a.jpg", "b.jpg", "c.jpg"])
    scene = artifact(tmp_path / "scene", "scene", names=["b.jpg"])
    (remark,) = photos_missing_or_cropped(finished({"capture": capture}, {"scene": scene}, folded=["c.jpg"]))
    assert remark.text.startswith("1 of 3 photos placed; the log names the others. 1 of them fits no real lens")
    assert "overlap" not in remark.text
    assert remark.details == "Not placed: a.jpg, c.jpg; because of their lenses: c.jpg"


def test_photos_that_would_have_cropped_all_others_are_told(tmp_path: Path) -> None:
    capture = artifact(tmp_path / "capture", "capture", names=["a.jpg", "b.jpg", "c.jpg"])
    scene = artifact(tmp_path / "scene", "scene", names=["a.jpg"])
    facts = {"folded": ["b.jpg"], "cropping": ["c.jpg"]}
    (remark,) = photos_missing_or_cropped(finished({"capture": capture}, {"scene": scene}, **facts))
    assert "1 of them fits no real lens, and was left out" in remark.text
    assert "1 of them was taken in the other orientation (portrait or landscape) or zoomed, and was" in remark.text
    assert remark.text.endswith("left out: all others would have been cropped to what it shows.")
    because = "because of their lenses: b.jpg; taken in the other orientation or zoomed: c.jpg"
    assert remark.details == f"Not placed: b.jpg, c.jpg; {because}"


def test_where_all_are_placed_that_is_said_as_what_was_wished(tmp_path: Path) -> None:
    capture, scene = (artifact(tmp_path / kind, kind, names=["a.jpg"]) for kind in ("capture", "scene"))
    (remark,) = photos_missing_or_cropped(finished({"capture": capture}, {"scene": scene}))
    assert remark == Remark("1 of 1 photo placed", as_wished=True)


@pytest.mark.parametrize(
    ("shares", "said"),
    [
        ([0.5625, 1.0, 0.5625], "56 % of most photos"),
        ([0.11, 1.0, 0.11], "11 % of most photos"),
        ([0.11, 1.0, 1.0], ""),  # few see more than the others
        ([0.9, 1.0, 0.9], ""),
    ],
)
def test_pictures_that_one_photo_crops(tmp_path: Path, shares: list[float], said: str) -> None:
    names = ["a.jpg", "b.jpg", "c.jpg"]
    capture, scene = (artifact(tmp_path / kind, kind, names=[*names]) for kind in ("capture", "scene"))
    placed, *remarks = photos_missing_or_cropped(
        finished({"capture": capture}, {"scene": scene}, shares_shown=[*shares])
    )
    assert placed.text == "3 of 3 photos placed"
    assert bool(remarks) is bool(said)
    for remark in remarks:
        assert said in remark.text
        assert "1 of 3" in remark.text
        assert ".jpg" not in remark.text
        assert remark.details == "These show least: b.jpg"


@pytest.mark.parametrize(("left", "said"), [(0, ()), (10, ("15 of 25 photos came with a pose; the others",))])
def test_photos_without_poses(left: int, said: tuple[str, ...]) -> None:
    remarks: tuple[Remark, ...] = photos_left_out(finished({}, {}, photos=15, without_pose=left))
    assert len(remarks) == len(said)
    assert all(remark.text.startswith(text) for remark, text in zip(remarks, said, strict=True))


def test_poses_without_photos() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=22, without_photo=2))
    assert remark.text == "2 poses were left out because their photos are missing; the log names some."


def test_photos_in_another_place() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=22, without_pose=0, left_out=1))
    assert remark.text.startswith("1 more photo, in the folder itself or in another of its subfolders, was left out")


def test_photos_in_folders_beside_and_masks() -> None:
    below, masked = photos_left_out(finished({}, {}, photos=3, below=400, masked=2))
    assert below.text.startswith("400 photos lie in folders beside the 3 that were used")
    assert "those of a rig" in below.text
    assert masked.text.startswith("2 frames name masks, which are not used")
    (few,) = photos_left_out(finished({}, {}, photos=12, below=6))
    assert few.text.startswith("6 photos lie in folders beside the 12 that were used, and were left out.")
    assert "rig" not in few.text


def test_pictures_that_are_not_read() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=8, copies=8))
    assert remark.text.startswith("8 of 16 photos are exact copies of others and were left out")
    (remark,) = photos_left_out(finished({}, {}, photos=3, unread={".heic": 30, ".dng": 1}))
    assert remark.text == "31 pictures (.heic, .dng) cannot be read and were left out; convert them to JPEG."
    assert photos_left_out(finished({}, {}, photos=3, unread={})) == ()
    (remark,) = photos_left_out(finished({}, {}, photos=3, unread={".heic": 1}))
    assert remark.text == "1 picture (.heic) cannot be read and was left out; convert it to JPEG."
    (remark,) = photos_left_out(finished({}, {}, photos=8, copies=1))
    assert remark.text == "1 of 9 photos is an exact copy of another and was left out; the log names it."


def test_files_of_a_folder_of_any_pictures_that_were_not_looked_at() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=3, not_looked_at=4))
    assert remark.text.startswith("3 pictures are examined. 4 other files")
    assert photos_left_out(finished({}, {}, photos=3, not_looked_at=0)) == ()


def test_where_no_pictures_are_given_it_is_said_that_the_photos_are_used() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=30, not_looked_at=0, own_photos=True))
    assert remark.text == "No pictures given: your own 30 photos are used instead."


def test_pictures_of_a_folder_of_any_that_cannot_be_read() -> None:
    (remark,) = photos_left_out(finished({}, {}, photos=20, unreadable=["a.jpg"]))
    assert remark.text == "1 of 21 pictures cannot be read and is left out; the log names it."
    assert remark.details.endswith("a.jpg")
    assert photos_left_out(finished({}, {}, photos=3, unreadable=[])) == ()


@pytest.mark.parametrize(
    ("test_names", "legal", "said"),
    [
        (["a.jpg"], [False, True], True),
        (["a.jpg"], [True, False], False),
        (["a.jpg", "b.jpg"], [False, True], False),
        ([], [False, False], False),  # nothing would be scored
    ],
)
def test_a_message_that_no_test_view_shows(
    tmp_path: Path, test_names: list[str], legal: list[bool], said: bool
) -> None:
    cover = artifact(tmp_path / "cover", "scene", names=["a.jpg", "b.jpg"], test_names=[*test_names])
    views = artifact(tmp_path / "views", "views", names=["a.jpg", "b.jpg"], legal=[*legal], message="Zebraquartz")
    remarks = message_hardly_seen(finished({"cover": cover}, {"views": views}))
    assert bool(remarks) is said
    assert not any("Zebraquartz" in remark.text for remark in remarks)


@pytest.mark.parametrize(
    ("placement", "advice"), [("aligned", "Choose a message"), ("same_world", "too few iterations")]
)
def test_nobody_chooses_another_message_where_it_is_the_cover_edited(
    tmp_path: Path, placement: str, advice: str
) -> None:
    cover = artifact(tmp_path / "cover", "scene", names=["a.jpg"], test_names=["a.jpg"])
    views = artifact(tmp_path / "views", "views", names=["a.jpg"], legal=[False], message="Zebraquartz")
    (remark,) = message_hardly_seen(finished({"cover": cover}, {"views": views}, placement=placement))
    assert advice in remark.text


@pytest.mark.parametrize(
    ("point", "colour", "said"),
    [
        (0.5, 10, ["The message is the cover itsel"]),
        (0.7, 10, []),
        (0.5, 11, []),  # a converter with a fixed seed writes the same random points for any photos
    ],
    ids=["the same", "other points", "other pictures"],
)
def test_a_cover_that_is_its_own_message_is_a_slip(tmp_path: Path, point: float, colour: int, said: list[str]) -> None:
    """A message is private, and a cover is not, so they are different artifacts of the same photos."""

    def scene(name: str, first: float, shade: int, private: bool) -> Artifact:
        with create(tmp_path / name, "scene", private) as writer:
            writer.attributes |= {"names": ["a.jpg"], "test_names": []}
            writer.write("points", np.array([[first, 0.0, 1.0]]))
            writer.write("pictures", np.full((1, 2, 2, 3), shade, np.uint8))
        return load(tmp_path / name)

    views = artifact(tmp_path / "views", "views", names=["a.jpg"], legal=[True], message="Zebraquartz")
    cover, message = scene("cover", 0.5, 10, private=False), scene("message", point, colour, private=True)
    remarks = message_hardly_seen(finished({"cover": cover, "message": message}, {"views": views}))
    assert [remark.text[:30] for remark in remarks] == said
