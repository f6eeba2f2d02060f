"""Whoever seals more messages than the channels have room for hears how much of them stays open."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import create, load
from pipeline.stage import Finished
from stages.hiding.remarks import MOST_LEFT_OPEN, left_open


@pytest.mark.parametrize(("messages", "channels"), [(1, 16), (4, 40)])
def test_what_a_seal_leaves_open_is_told_with_the_channels_that_would_do(
    tmp_path: Path, messages: int, channels: int
) -> None:
    with create(tmp_path / "secret", "secret", private=True) as writer:
        writer.attributes["messages"] = [f"message {number}" for number in range(messages)]
    made = {"secret": load(tmp_path / "secret")}
    facts = {"sealed": True, "seal_wanted": True}
    assert left_open(Finished({}, made, {**facts, "left_open": MOST_LEFT_OPEN})) == ()
    (remark,) = left_open(Finished({}, made, {**facts, "left_open": 0.496}))
    assert "leaves 50% of what the messages" in remark.text
    assert f"feature_dim: {channels} has room" in remark.text
    assert "message 0" not in remark.text, "remarks are printed and logged"
