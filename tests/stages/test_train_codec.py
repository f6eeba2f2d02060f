"""A codec learns to hide and to find, goes on where it was stopped, and is rated on other photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, load
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services
from stages.analysis.codec_quality import FOUND, GIVEN, MARKED
from stages.analysis.measurements import read_measurements
from stages.hiding.watermark.codec import new_codec
from stages.imaging.metric_table import read_rows
from stages.train_codec import TrainCodecParameters, train_codec
from stages.training.codec import FOUND as WATERMARK
from stages.training.codec import MARKED as WATERMARKED
from stages.training.codec import CodecSettings, CodecTraining, rounded
from tests.running import run_stage
from tests.stages import small
from tests.stages.watermarks import capture, emblem, errors_of, stored_capture

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
    made_with = load(tmp_path / "first" / ".scratch" / "checkpoint-1").attributes["made_with"]
    assert isinstance(made_with, dict)
    assert {"device", "pyopencl", "opencv-contrib-python-headless"} <= made_with.keys(), "what others may change bits"
    (tmp_path / "parts").mkdir()
    (tmp_path / "first" / ".scratch").rename(tmp_path / "parts" / ".scratch")
    parts = run_stage(train_codec, parameters, inputs, tmp_path / "parts", services=services)
    assert any("goes on from step 5" in line for line in lines)
    assert {name: parts[name].digest for name in parts} == {name: whole[name].digest for name in whole}


def test_without_photos_it_says_where_some_are(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="scikit-image"):
        run_stage(train_codec, TrainCodecParameters.model_validate(SETTINGS), {}, tmp_path / "made")


def test_a_capture_of_one_photo_is_told_to_leave_nothing_to_train_on(tmp_path: Path) -> None:
    photos = (stored_capture(tmp_path / "photos", {"alone.png": small.pictures(0)[0]}),)
    with pytest.raises(UserError, match="found only a capture of one photo, which is held out; expected"):
        run_stage(train_codec, TrainCodecParameters.model_validate(SETTINGS), {"photos": photos}, tmp_path / "made")


def training_of_a_new_codec(**settings: float) -> CodecTraining:
    """The codec hides and finds nothing yet; the photo is white, and the given watermark is a fifth as bright."""
    photo, watermark = (np.full((16, 16, 3), level, np.uint8) for level in (255, 51))
    return CodecTraining(new_codec(1, 4, seed=0), [photo], [watermark], CodecSettings(10, 0, window=8, **settings))


def test_the_watermarked_picture_counts_by_its_weight_and_the_watermark_by_one() -> None:
    training = training_of_a_new_codec(fidelity_weight=5.0)
    weighed = {name: training.weighed(name, torch.tensor(2.0), 1).item() for name in errors_of(training, 1)}
    assert weighed == {WATERMARKED: 10, WATERMARK: 2}


@pytest.mark.parametrize(("share", "light"), [(0.0, 1.0), (1.0, 0.2)])
def test_errors_are_those_beside_the_photo_and_beside_the_watermark(share: float, light: float) -> None:
    """The watermark is either the given one or a window of a photo."""
    errors = errors_of(training_of_a_new_codec(given_share=share), 1)
    assert errors[WATERMARKED] == pytest.approx(0, abs=1e-9)
    assert errors[WATERMARK] == pytest.approx(light**2)


@pytest.mark.parametrize(("largest_noise", "least", "most"), [(0.0, 0.0, 0.0), (0.1, 1e-4, 1e-2)])
def test_watermarks_are_found_in_bytes_and_noise(
    monkeypatch: pytest.MonkeyPatch, largest_noise: float, least: float, most: float
) -> None:
    """The encoder darkens a photo by less than half a grey level, and the decoder shows its input."""
    training = training_of_a_new_codec(given_share=0, largest_noise=largest_noise)
    monkeypatch.setattr(training.codec, "watermark_encoder", lambda images, watermarks: images - 0.001)
    monkeypatch.setattr(training.codec, "watermark_decoder", lambda images: images)
    errors = errors_of(training, 1)
    assert errors[WATERMARKED] == pytest.approx(1e-6, rel=1e-3)
    assert least <= errors[WATERMARK] <= most


def test_rounding_clamps_and_lets_gradients_pass() -> None:
    values = torch.tensor([[-0.5, 0.2, 0.2005, 1.5]], requires_grad=True)
    rounded(values).sum().backward()
    torch.testing.assert_close(rounded(values).detach(), torch.tensor([[0, 0.2, 0.2, 1]]))
    assert values.grad is not None
    assert values.grad.tolist() == [[1, 1, 1, 1]]
