"""Pictures to look through: those directly in the folder, or the error says where some are; or one's own photos."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import UserError
from stages.scene.capture import read_capture
from tests.stages.test_photos import capture, take

WORKFLOW = Path(__file__).parents[3] / "workflows" / "trace_pictures.yaml"


def refused(folder: Path, out: Path) -> UserError:
    with pytest.raises(UserError) as raised:
        capture(folder, out, any_pictures=True)
    return raised.value


def test_where_none_was_given_the_captures_own_photos_are_looked_at(tmp_path: Path) -> None:
    """Wherever they are, without what is beside them; of any other folder, only pictures directly in it count."""
    scan = tmp_path / "scan"
    log: list[str] = []
    for path in ("images/1.png", "images/2.png", "preview.png", "masks/1.png"):
        take(scan / path)
    (tmp_path / "link").symlink_to(scan)
    own = capture(tmp_path / "link", tmp_path / "own", log, any_pictures=True, own_photos=scan)
    assert read_capture(own).names == ("1.png", "2.png")
    assert "no pictures given: your own 2 photos are tried" in log
    assert not any("not looked at" in line for line in log)
    other = capture(scan, tmp_path / "other", log, any_pictures=True, own_photos=scan / "images")
    assert read_capture(other).names == ("preview.png",)
    assert sum("no pictures given" in line for line in log) == 1
    assert 'own_photos: "${cover}"' in WORKFLOW.read_text()


def test_pictures_in_folders_below_are_not_looked_at_but_told(tmp_path: Path) -> None:
    for path in ("found/images/1.png", "found/images/2.gif", "found/.hidden/3.png"):
        take(tmp_path / path)
    error = refused(tmp_path / "found", tmp_path / "out")
    assert (error.found, error.remedy) == (
        "2 pictures in images",
        f"Give that folder: {tmp_path / 'found' / 'images'}",
    )
    take(tmp_path / "found" / "site" / "deep" / "1.png")
    error = refused(tmp_path / "found", tmp_path / "more")
    assert error.found == "2 pictures in images, 1 picture in site/deep"
    assert str(error.remedy).startswith("Give one of these")
    for number in range(6):
        take(tmp_path / "found" / str(number) / "1.png")
    assert str(refused(tmp_path / "found", tmp_path / "most").found).endswith(", more in 3 other folders")


def test_a_folder_without_pictures_is_told_as_one_of_pictures(tmp_path: Path) -> None:
    """The error does not speak of a capture, a rig or `images`, none of which the user has mentioned."""
    folder = tmp_path / "found"
    folder.mkdir()
    for place in (folder, tmp_path / "nowhere"):
        said = str(refused(place, tmp_path / f"out of {place.name}"))
        assert "pictures to look through" in said
        assert not any(word in said for word in ("capture", "rig", "images"))
    (folder / "1.heic").write_bytes(b"not read")
    error = refused(folder, tmp_path / "out of unread")
    assert error.remedy == "Convert the pictures (.heic), which cannot be read, to JPEG."
