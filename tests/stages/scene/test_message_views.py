"""What is wrong with messages is told without their names: errors are printed and logged."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import UserError
from stages.scene.message_views import read_messages
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
