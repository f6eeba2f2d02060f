"""Items become runs: which belong together, which are the same training, and what is unusual about them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.stage import Item
from stages.analysis.paper.chapter import usual
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Columns, Study, method_title, read_study
from stages.imaging.metric_table import MetricRow
from tests.stages.analysis.paper import synthetic
from tests.stages.analysis.paper.synthetic import image_rows, metrics, scene_rows


def read(items: list[Item], timings: list[Item] | None = None) -> Study:
    return read_study(items, timings or [], Columns(), read_published().setup)


def item(folder: Path, name: str, rows: list, **values: object) -> Item:
    return Item(name, values, f"scores[{name}]", metrics(folder, name, rows))


def test_the_reference_of_several_methods_is_one_run(tmp_path: Path) -> None:
    methods = ("plain", "sh", "gs_hider")
    study = read(
        [
            item(tmp_path, method, scene_rows("fox", method, messages=("reef",)), capture="fox", method=method)
            for method in methods
        ]
    )
    assert sorted(run.method for run in study.runs) == ["gs_hider", "plain", "sh"]


def test_references_of_several_seeds_are_several_runs(tmp_path: Path) -> None:
    study = read(list(synthetic.fidelity_items(tmp_path)))
    plain = [run for run in study.runs if run.method == "plain" and run.capture == "fox"]
    assert len(plain) == 3
    assert len([run for run in study.runs if run.method == "plain"]) == 5


def test_settings_are_what_is_unusual(tmp_path: Path) -> None:
    rows = scene_rows("fox", "gs_hider", messages=("reef",))
    longer = scene_rows("fox", "gs_hider", cover=0.1, messages=("reef",))
    study = read(
        [
            item(tmp_path, "a", rows, capture="fox", method="gs_hider", feature_dim=16, layers=5, iterations=3000),
            item(tmp_path, "b", longer, capture="fox", method="gs_hider", lambda_message=0.25, iterations=6000),
        ]
    )
    hiding = study.select(lambda run: run.method == "gs_hider")
    assert [run.settings for run in hiding] == [(), (("lambda_message", 0.25), ("iterations", 6000.0))]
    assert study.iterations == 3000
    assert [method_title(run) for run in hiding] == ["GS-Hider", "GS-Hider, λ = 0.25, 6,000 iterations"]
    assert usual(hiding) == hiding[:1]
    assert usual(hiding[1:]) == hiding[1:]
    assert {name for run in study.runs if run.method == "plain" for name, _ in run.settings} <= {"iterations"}


def test_decoders_of_an_unusual_width_are_named(tmp_path: Path) -> None:
    """What is usual depends on the method."""
    wide = {"gs_hider": (64, 96), "homogeneous": (32, 64)}
    study = read(
        [
            item(
                tmp_path,
                f"{method} {width}",
                scene_rows("fox", method, cover=width / 1000, messages=("reef",)),
                capture="fox",
                method=method,
                decoder_width=width,
            )
            for method, widths in wide.items()
            for width in widths
        ]
    )
    titles = [method_title(run) for run in study.runs if run.method != "plain"]
    ours = "Homogeneous GS-Hider"
    assert titles == ["GS-Hider", "GS-Hider, decoders 96 wide", ours, f"{ours}, decoders 64 wide"]


def test_what_was_not_measured_makes_no_second_run(tmp_path: Path) -> None:
    rows = [*scene_rows("fox", "plain"), MetricRow("psnr_covered", math.nan, "dB", "a", "test", None, None, "plain")]
    study = read([item(tmp_path, name, rows, capture="fox", method="plain", seed=0) for name in ("a", "b")])
    assert len(study.runs) == 1


def test_an_image_has_a_weight_of_its_own(tmp_path: Path) -> None:
    rows = image_rows("fox", "gs_hider", "boat")
    study = read(
        [
            item(tmp_path, "a", rows, capture="fox", method="gs_hider", lambda_message=0.1),
            item(tmp_path, "b", rows, capture="bonsai", method="gs_hider", lambda_message=0.5),
        ]
    )
    images = study.select(lambda run: run.hides_image)
    assert [run.settings for run in images] == [(), (("lambda_message", 0.5),)]
    assert images[0].hiding_views == {synthetic.HIDING_VIEW}
    assert images[0].messages == ("boat",)


def test_what_was_not_made_is_told_and_the_rest_is_read(tmp_path: Path) -> None:
    made = item(tmp_path, "a", scene_rows("fox", "plain"), capture="fox")
    study = read([Item("b", {"capture": "fox"}, "scores[b]", None, "out of memory"), made])
    assert study.failures == (("b", "out of memory"),)
    assert [run.method for run in study.runs] == ["plain"]
    assert read([]) == Study(())


def test_without_a_foreach_there_is_one_capture(tmp_path: Path) -> None:
    [run] = read([Item("scores", {}, "scores", metrics(tmp_path, "m", scene_rows("fox", "plain")))]).runs
    assert (run.capture, run.method, run.seed) == ("", "plain", "")


def test_some_items_without_a_capture_are_refused(tmp_path: Path) -> None:
    rows = scene_rows("fox", "plain")
    items = [item(tmp_path, "a", rows, capture="fox"), item(tmp_path, "b", rows, scene="fox")]
    with pytest.raises(UserError, match="b: some items do not say what capture they are of; expected a column 'captu"):
        read(items)


def test_times_take_the_method_of_their_item(tmp_path: Path) -> None:
    study = read([], list(synthetic.timing_items(tmp_path)))
    assert {run.method for run in study.timings} == set(synthetic.SECONDS)
    assert study.captures == ("fox", "bonsai", "kitchen")
