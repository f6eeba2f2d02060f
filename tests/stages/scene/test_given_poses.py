"""Which photo a file of poses means by a path."""

from __future__ import annotations

import json
from pathlib import Path
from unicodedata import normalize

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.scene import given_poses
from stages.scene.given_poses import photo_finder, read_poses


def test_of_folders_before_a_photo_only_those_are_looked_at_that_can_be_in_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path may have thousands: if each of its endings were compared, hostile files would take hours."""
    find = photo_finder(["left_far_1.jpg", "left_2.jpg"], tmp_path)
    looked_at: list[str] = []

    def path(written: str) -> Path:
        looked_at.append(written)
        return Path(written)

    monkeypatch.setattr(given_poses, "Path", path)
    assert find("d/" * 2000 + "left/far/1.png") == "left_far_1.jpg"
    assert find("d/" * 2000 + "left/far/3.png") is None
    assert len(looked_at) < 10


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_accented_letters_are_the_same_however_they_are_composed(form: str) -> None:
    """macOS decomposes names of files, which a file of poses from there then has decomposed, too."""
    photo = normalize(form, "café_1.jpg")
    find = photo_finder([photo, "cafe_1.jpg"], Path("transforms.json"))
    assert find(normalize("NFC", "images/café/1.jpg")) == find(normalize("NFD", "images/café/1.jpg")) == photo


@pytest.mark.parametrize(("width", "fits"), [(644, True), (660, False)])
def test_poses_fit_photos_of_the_same_proportions_up_to_a_hundredth(tmp_path: Path, width: int, fits: bool) -> None:
    """Resizing rounds a side; what differs by more was cropped."""
    frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist()}
    place = tmp_path / "transforms.json"
    place.write_text(json.dumps({"fl_x": 500.0, "w": 640, "h": 480, "frames": [frame]}))
    if fits:
        _, [posed], _ = read_poses(place, {"a.jpg": (width, 480)})
        assert (posed.lens.width, posed.lens.height) == (width, 480)
    else:
        with pytest.raises(UserError, match="another shape"):
            read_poses(place, {"a.jpg": (width, 480)})
