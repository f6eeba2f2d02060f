"""As many messages as asked for are hidden and evaluated, however many are given."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.analysis.comparisons import read_comparisons
from stages.analysis.videos import read_videos
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.imaging.metric_table import read_rows
from stages.render_path import RenderPathParameters, render_path
from tests.running import run_stage
from tests.stages.small import NAMES, message_views, scene, splats

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


def test_views_that_were_held_out_are_the_test_views(tmp_path: Path) -> None:
    cover = scene(tmp_path / "cover", test_views=3)
    inputs = {"container": splats(tmp_path / "splats"), "cover": cover}
    made = run_stage(evaluate, EvaluateParameters(method="plain", lpips="none"), inputs, tmp_path / "scores")
    views = {
        split: {row.view for row in read_rows(made["scores"]) if row.split == split} for split in ("test", "train")
    }
    assert views == {"test": set(NAMES[:3]), "train": set(NAMES[3:])}


def test_what_a_message_covers_is_not_read_to_hide_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For many large pictures, it would take gigabytes."""
    whole, arrays = Artifact.read, list[str]()
    monkeypatch.setattr(Artifact, "read", lambda artifact, name: (arrays.append(name), whole(artifact, name))[1])
    inputs = {"cover": scene(tmp_path / "cover"), "messages": (message_views(tmp_path / "views"),)}
    run_stage(hide_scenes, HideScenesParameters.model_validate(SETTINGS), inputs, tmp_path / "made")
    assert arrays.count("pictures") == 2
    assert "coverage" not in arrays


@pytest.mark.parametrize("given", [0, 1])
def test_more_messages_than_there_are_cannot_be_hidden(tmp_path: Path, given: int) -> None:
    inputs = {"cover": scene(tmp_path / "cover"), "messages": (message_views(tmp_path / "views"),)[:given]}
    parameters = HideScenesParameters.model_validate({**SETTINGS, "hidden": 2})
    with pytest.raises(UserError, match=f"hidden: 2, {given} messages; expected hidden: at most {given}"):
        run_stage(hide_scenes, parameters, inputs, tmp_path / "made")


def test_features_of_zeros_are_refused_by_methods_that_have_none(tmp_path: Path) -> None:
    parameters = HideScenesParameters.model_validate({**SETTINGS, "method": "sh", "initial_features": "zeros"})
    with pytest.raises(UserError, match="has no features that could start"):
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


def test_features_of_zeros_are_learnt_by_every_method_that_has_some(tmp_path: Path) -> None:
    """With decoders that read no direction at all, training would start on a saddle and features would never change."""
    inputs = {"cover": scene(tmp_path / "cover"), "messages": (message_views(tmp_path / "views"),)}
    for method in ("gs_hider", "homogeneous"):
        settings = {**SETTINGS, "iterations": 1, "method": method, "initial_features": "zeros"}
        made = run_stage(hide_scenes, HideScenesParameters.model_validate(settings), inputs, tmp_path / method)
        assert abs(made["container"].read("raw_features")).max() > 1e-3


@pytest.mark.parametrize(
    ("method", "feature_dim", "roles"),
    [
        ("gs_hider", 2, ["cover", "message", "feature_map"]),
        ("gs_hider", 3, ["cover", "message", "feature_map"]),
        ("sh", 8, ["cover", "message"]),
        ("decoder", 8, ["cover", "message"]),
    ],
)
def test_a_feature_map_is_shown_of_features_however_few_and_of_nothing_else(
    tmp_path: Path, method: str, feature_dim: int, roles: list[str]
) -> None:
    """3DGS+SH also blends six channels, but they are the pictures of cover and message themselves."""
    cover, views = scene(tmp_path / "cover"), message_views(tmp_path / "views")
    settings = {**SETTINGS, "method": method, "feature_dim": feature_dim}
    parameters = HideScenesParameters.model_validate(settings)
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    inputs = {"container": made["container"], "secret": made["secret"], "cover": cover}
    scores = run_stage(
        evaluate, EvaluateParameters(method=method, lpips="none"), inputs | {"messages": (views,)}, tmp_path / "scores"
    )
    assert [comparison.role for comparison in read_comparisons(scores["pictures"])] == roles
    filmed = run_stage(render_path, RenderPathParameters(method=method, frames=2), inputs, tmp_path / "filmed")
    assert [video.role for video in read_videos(filmed["videos"])] == [*roles, "side_by_side"]
