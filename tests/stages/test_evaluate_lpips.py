"""LPIPS is measured with the networks whose weights are installed, and only these become part of the key."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.stage import Services
from stages import evaluate as stage
from stages.attack import AttackParameters
from stages.evaluate import EvaluateParameters, evaluate
from stages.imaging import lpips
from stages.imaging.lpips import Lpips, networks_for
from stages.imaging.lpips_weights import Network, weights_file
from stages.imaging.metric_table import read_rows
from tests.running import run_stage
from tests.stages import small
from tests.stages.imaging.test_lpips import random_weights


@pytest.mark.parametrize(
    ("installed", "wanted", "measured"),
    [
        ([], "both", "none"),
        ([], "vgg", "none"),
        (["alex"], "both", "alex"),
        (["vgg"], "alex", "none"),
        (["vgg"], "vgg", "vgg"),
        (["alex", "vgg"], "both", "both"),
        (["alex", "vgg"], "none", "none"),
    ],
)
def test_as_far_as_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: list[Network], wanted: str, measured: str
) -> None:
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path))
    for network in installed:
        weights_file(network).touch()
    assert EvaluateParameters.model_validate({"lpips": wanted}).lpips == measured
    assert AttackParameters.model_validate({"lpips": True}).lpips == ("vgg" in installed)
    assert not AttackParameters.model_validate({"lpips": False}).lpips


def test_pictures_that_a_network_is_too_deep_for_are_scored_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures are 32 x 24 pixels: VGG16 needs 16 a side, AlexNet 31."""
    monkeypatch.setattr(stage, "weights_installed", lambda network: True)
    monkeypatch.setattr(lpips, "load_lpips", lambda network, device: Lpips(network, random_weights(network), device))
    log: list[str] = []
    inputs = {"container": small.splats(tmp_path / "splats"), "cover": small.scene(tmp_path / "cover")}
    parameters = EvaluateParameters(method="plain", lpips="both", threads=1)
    made = run_stage(evaluate, parameters, inputs, tmp_path / "scores", services=Services(log=log.append))
    measured = {row.quantity for row in read_rows(made["scores"])}
    assert "lpips_vgg" in measured
    assert "lpips_alex" not in measured
    assert [line for line in log if "LPIPS" in line] == [
        "LPIPS (alex) is not measured: pictures of 32 x 24 pixels have less than the 31 a side that it needs"
    ]


def test_the_smallest_pictures_are_measured() -> None:
    assert networks_for(["vgg", "alex"], 31, 40, print) == ("vgg", "alex")
    assert networks_for(["vgg", "alex"], 40, 16, print) == ("vgg",)
    assert networks_for(["vgg", "alex"], 15, 40, print) == ()
