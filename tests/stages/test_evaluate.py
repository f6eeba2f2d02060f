"""Plain 3DGS beside a container is scored as a control, and what cannot be scored is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.analysis.comparisons import read_comparisons
from stages.analysis.leakage import correlation
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_image import hide_image
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.imaging.image import write_image
from stages.imaging.metric_table import read_rows
from tests.running import run_stage
from tests.stages import small


def test_messages_without_the_secret_are_refused(tmp_path: Path) -> None:
    inputs = {"container": small.splats(tmp_path / "splats"), "cover": small.scene(tmp_path / "cover")}
    messages = {"messages": (small.message_views(tmp_path / "views"),)}
    with pytest.raises(UserError, match="cannot be read without the secret"):
        run_stage(evaluate, EvaluateParameters(method="plain", lpips="none"), inputs | messages, tmp_path / "scores")


def test_a_container_of_another_method_is_refused(tmp_path: Path) -> None:
    inputs = {"container": small.splats(tmp_path / "splats"), "cover": small.scene(tmp_path / "cover")}
    with pytest.raises(UserError, match="made by another method"):
        run_stage(evaluate, EvaluateParameters(method="gs_hider", lpips="none"), inputs, tmp_path / "scores")


def test_of_plain_3dgs_only_its_residuals_are_compared_with_the_message(tmp_path: Path) -> None:
    """With the message of the same view and, as the control, of the other test view; from pictures of 8 bits here."""
    cover, views = small.scene(tmp_path / "cover", test_views=2), small.message_views(tmp_path / "views")
    parameters = HideScenesParameters.model_validate({"method": "sh", "iterations": 1, "message_points": 20})
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    given = {"container": made["container"], "secret": made["secret"], "cover": cover, "messages": (views,)}
    given["reference"] = small.splats(tmp_path / "plain")
    scored = run_stage(evaluate, EvaluateParameters(method="sh", lpips="none"), given, tmp_path / "scores")
    rows = [row for row in read_rows(scored["scores"]) if row.message is not None]
    by_method = {name: {row.quantity for row in rows if row.method == name} for name in ("plain", "sh")}
    assert by_method["plain"] == {"residual_correlation", "residual_correlation_others"} < by_method["sh"]
    covers = {each.method: each for each in read_comparisons(scored["pictures"]) if each.role == "cover"}
    assert covers.keys() == by_method.keys()
    for name, shown in covers.items():
        assert shown.names == small.NAMES[:4], "test views and the first two others"
        residuals = shown.rendered[:2] / 255 - shown.truth[:2] / 255
        messages = small.pictures(1)[:2] / 255
        pairs = np.abs([[correlation(each, message) for message in messages] for each in residuals])
        for quantity, expected in (
            ("residual_correlation", (pairs[0, 0], pairs[1, 1])),
            ("residual_correlation_others", (pairs[0, 1], pairs[1, 0])),
        ):
            found = {row.view: row.value for row in rows if (row.method, row.quantity) == (name, quantity)}
            assert [found[view] for view in small.NAMES[:2]] == pytest.approx(expected, abs=0.01)
            assert len(found) == 2


def test_of_a_hidden_image_plain_3dgs_knows_nothing(tmp_path: Path) -> None:
    cover = small.scene(tmp_path / "cover")
    with create(tmp_path / "emblem", "image", private=True) as writer:
        write_image(writer, "emblem", small.pictures(1)[0])
    emblem = load(tmp_path / "emblem")
    parameters = hide_image.parameters.model_validate({"method": "sh", "iterations": 1})
    made = run_stage(hide_image, parameters, {"cover": cover, "image": emblem}, tmp_path / "made")
    given = {"container": made["container"], "secret": made["secret"], "cover": cover, "image": emblem}
    given["reference"] = small.splats(tmp_path / "plain")
    scored = run_stage(evaluate, EvaluateParameters(method="sh", lpips="none"), given, tmp_path / "scores")
    rows = read_rows(scored["scores"])
    methods = {name: {row.message for row in rows if row.method == name} for name in ("sh", "plain")}
    assert methods == {"sh": {None, "emblem"}, "plain": {None}}
    public = read_rows(scored["public_scores"])
    assert {row.message for row in public} == {None}
    assert {row.view for row in public if row.split == "train"} == {None}, "the view that hides it could stand out"
    assert {row.view for row in public if row.split == "test"} == {small.NAMES[0]}
    shown = {name for each in read_comparisons(scored["public_pictures"]) for name in each.names}
    assert shown == {small.NAMES[0]}, "also by its picture"
    assert "total_bytes" not in {row.quantity for row in public}, "it would tell that there is a secret"
