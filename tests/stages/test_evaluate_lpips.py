"""LPIPS is measured as far as its weights are installed, and what is asked for beyond that is part of no key."""

from __future__ import annotations

from pathlib import Path

import pytest

from stages.evaluate import EvaluateParameters
from stages.imaging.lpips_weights import Network, weights_file


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
