"""Views are paired by name. Errors about messages do not give their names, since errors are printed and logged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.scene.message_views import LEGAL_COVERAGE, MessageViews, read_messages, write_message_views
from tests.stages.small import NAMES, message_views

MESSAGE = "statue"


def test_two_messages_of_one_name(tmp_path: Path) -> None:
    artifacts = [message_views(tmp_path / "first"), message_views(tmp_path / "second")]
    with pytest.raises(UserError, match=r"second: two messages .* found the name of message 1 of 2 again") as raised:
        read_messages(artifacts, NAMES)
    assert MESSAGE not in str(raised.value)


def test_a_message_that_lacks_a_view(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"views: a message was not .* found no picture for another\.png") as raised:
        read_messages([message_views(tmp_path / "views")], [*NAMES, "another.png"])
    assert MESSAGE not in str(raised.value)


def test_views_are_paired_by_name(tmp_path: Path) -> None:
    """In any order, even if the message was rendered for more views."""
    pictures = np.arange(3, dtype=np.uint8)[:, None, None, None].repeat(3, axis=3)
    coverage = np.array([0, LEGAL_COVERAGE, 1], np.float32)[:, None, None]
    points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    with create(tmp_path / "views", "views", private=True) as writer:
        write_message_views(writer, MessageViews(MESSAGE, ("a", "b", "c"), pictures, points, colors, coverage))
    artifact = load(tmp_path / "views")
    assert artifact.attributes["legal"] == [False, True, True]
    views = read_messages([artifact], ["c", "a"])[MESSAGE]
    assert views.view_names == ("c", "a")
    assert views.pictures[:, 0, 0, 0].tolist() == [2, 0]
    assert views.mean_coverage.tolist() == [1, 0]
