"""Which photo a file of poses means by a path."""

from __future__ import annotations

from pathlib import Path

import pytest

from stages.scene import given_poses
from stages.scene.given_poses import photo_finder


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
