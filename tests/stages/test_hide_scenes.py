"""Messages are hidden, as many as were asked for, and evaluated, however many are given."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.stage import run_stage
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.imaging.metric_table import read_rows
from tests.stages.small import message_views, scene

SETTINGS = {"iterations": 2, "decoder_width": 8, "feature_dim": 8}


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous", "sh", "decoder"])
@pytest.mark.parametrize("hidden", [0, 1, None])
def test_only_what_is_hidden_is_scored(tmp_path: Path, method: str, hidden: int | None) -> None:
    cover, views = scene(tmp_path / "cover"), message_views(tmp_path / "views")
    parameters = HideScenesParameters.model_validate({**SETTINGS, "method": method, "hidden": hidden})
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    inputs = {"container": made["container"], "secret": made["secret"], "cover": cover, "messages": (views,)}
    rows = read_rows(
        run_stage(evaluate, EvaluateParameters(method=method, lpips="none"), inputs, tmp_path / "scores")["scores"]
    )
    sizes = {row.quantity: row.value for row in rows if row.quantity.endswith("bytes")}
    assert {row.message for row in rows} == ({None} if hidden == 0 else {None, "statue"})
    decoded = hidden != 0 and method != "sh"
    assert (sizes["total_bytes"] > sizes["container_bytes"]) == decoded


def test_features_of_zeros_are_refused_by_methods_that_have_none(tmp_path: Path) -> None:
    parameters = HideScenesParameters.model_validate({**SETTINGS, "method": "sh", "initial_features": "zeros"})
    with pytest.raises(UserError, match="no features"):
        run_stage(hide_scenes, parameters, {"cover": scene(tmp_path / "cover")}, tmp_path / "made")


def test_the_released_codes_start_is_grey_and_random(tmp_path: Path) -> None:
    settings = {**SETTINGS, "iterations": 1, "initial_features": "zeros", "feature_rate": 1e-9, "densify_gradient": 1e9}
    made = run_stage(
        hide_scenes,
        HideScenesParameters.model_validate(settings),
        {"cover": scene(tmp_path / "cover")},
        tmp_path / "made",
    )
    assert abs(made["container"].read("raw_features")).max() < 1e-6
