"""A codec learns to hide and to find, goes on where it was stopped, and says how good it is on other photos."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services, run_stage
from stages.analysis.codec_quality import FOUND, GIVEN, MARKED
from stages.analysis.measurements import read_measurements
from stages.imaging.metric_table import read_rows
from stages.train_codec import TrainCodecParameters, train_codec
from tests.stages.watermarks import capture, emblem

SETTINGS = {"iterations": 50, "blocks": 1, "width": 8, "window": 16, "batch": 2, "shipped_photos": ()}


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Artifact | tuple[Artifact, ...]]:
    return {"photos": (capture(tmp_path / "photos"),), "watermarks": (emblem(tmp_path / "emblem"),)}


def test_it_learns_to_find_what_it_hides(tmp_path: Path, inputs: dict) -> None:
    made = run_stage(train_codec, TrainCodecParameters.model_validate(SETTINGS), inputs, tmp_path / "made")
    found = [row.value for row in read_rows(made["curves"]) if row.method == "watermark"]
    assert len(found) == 50
    assert max(found[-5:]) > max(found[:5]) + 2
    conditions = {(row.quantity, row.condition) for row in read_measurements(made["scores"])}
    group = "other photos of the captures"
    assert conditions == {(quantity, name) for quantity in (MARKED, FOUND) for name in (group, GIVEN + group)}


def test_what_was_stopped_goes_on_to_the_same_bits(tmp_path: Path, inputs: dict) -> None:
    parameters = TrainCodecParameters.model_validate(SETTINGS | {"iterations": 12})
    whole = run_stage(train_codec, parameters, inputs, tmp_path / "whole")
    looks, lines = iter([False] * 4 + [True]), list[str]()
    services = Services(stop_requested=lambda: next(looks, False), log=lines.append)
    with pytest.raises(Interrupted, match="after step 5 of 12"):
        run_stage(train_codec, parameters, inputs, tmp_path / "first", services=services)
    (tmp_path / "parts").mkdir()
    (tmp_path / "first" / ".scratch").rename(tmp_path / "parts" / ".scratch")
    parts = run_stage(train_codec, parameters, inputs, tmp_path / "parts", services=services)
    assert any("goes on from step 5" in line for line in lines)
    assert {name: parts[name].digest for name in parts} == {name: whole[name].digest for name in whole}


def test_without_photos_it_says_where_some_are(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="scikit-image"):
        run_stage(train_codec, TrainCodecParameters.model_validate(SETTINGS), {}, tmp_path / "made")
