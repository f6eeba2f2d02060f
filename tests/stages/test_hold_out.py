"""The split that came with a capture takes the place of every eighth view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from pipeline.stage import run_stage
from stages.hold_out import HoldOutParameters, hold_out
from stages.scene.scene import read_scene
from tests.stages import small


def capture(folder: Path, test_names: list[str] | None) -> Artifact:
    """All of it that the stage reads."""
    with create(folder, "capture") as writer:
        writer.write_file("pictures/a.png", b"")
        if test_names is not None:
            writer.attributes["test_names"] = test_names
    return load(folder)


def run(directory: Path, test_names: list[str] | None) -> Artifact:
    inputs = {"scene": small.scene(directory / "given"), "capture": capture(directory / "capture", test_names)}
    return run_stage(hold_out, HoldOutParameters(), inputs, directory)["scene"]


def test_the_given_split_is_kept(tmp_path: Path) -> None:
    made = run(tmp_path, ["006.png", "001.png", "not placed.png"])
    scene, before = read_scene(made), read_scene(load(tmp_path / "given"))
    assert before.test_names == ("000.png",)
    assert scene.test_names == ("001.png", "006.png")
    assert len(scene.train_names) == small.VIEWS - 2
    np.testing.assert_array_equal(scene.pictures, before.pictures)
    np.testing.assert_array_equal(scene.points, before.points)


@pytest.mark.parametrize(
    ("test_names", "words"),
    [(None, "says nothing of test views"), (["x.png"], "no test view"), ([*small.NAMES], "nothing to train on")],
)
def test_splits_that_cannot_be_kept(tmp_path: Path, test_names: list[str] | None, words: str) -> None:
    with pytest.raises(UserError, match=words):
        run(tmp_path, test_names)
