"""The photos to learn from: some of each capture, never a scene of none."""

from __future__ import annotations

from pathlib import Path

from stages.training.codec_photos import learnt_photos
from tests.stages import small, watermarks


def test_a_capture_of_one_photo_is_no_scene_to_learn_from(tmp_path: Path) -> None:
    alone = watermarks.stored_capture(tmp_path / "alone", {"alone.png": small.pictures(0)[0]})
    lines: list[str] = []
    scenes = learnt_photos([watermarks.capture(tmp_path / "several"), alone], [], lines.append)
    assert [len(photos) for photos in scenes] == [small.VIEWS - 1]
    assert lines == ["capture 2 of the photos has no photo but one that is held out: nothing is learnt from it"]
