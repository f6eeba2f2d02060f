"""Items become runs: which belong together, which are the same training, and which settings are unusual."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.stage import Item
from stages.analysis.paper.ablations import value_of
from stages.analysis.paper.chapter import usual
from stages.analysis.paper.fidelity import fidelity
from stages.analysis.paper.frame_time import frame_time
from stages.analysis.paper.no_message import no_message
from stages.analysis.paper.public import public_study
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Columns, Experiment, Study, by_method, method_title, read_study
from stages.imaging.metric_table import MetricRow
from tests.stages.analysis.paper import synthetic
from tests.stages.analysis.paper.synthetic import image_rows, metrics, picture_rows, scene_rows


def read(items: list[Item], timings: list[Item] | None = None) -> Study:
    return read_study(items, timings or [], Columns(), read_published().setup)


def item(folder: Path, name: str, rows: list, **values: object) -> Item:
    return Item(name, values, f"scores[{name}]", metrics(folder, name, rows))


def test_of_private_scores_the_public_study_keeps_what_anyone_can_measure(tmp_path: Path) -> None:
    rows = scene_rows("fox", "gs_hider", messages=("reef",))
    study = public_study(read([item(tmp_path, "fox", rows, capture="fox", method="gs_hider")]), names_captures=False)
    kept = [row for run in study.runs for row in run.rows]
    assert {row.quantity for row in kept} == {"psnr", "ssim", "lpips_vgg", "lpips_alex", "container_bytes", "gaussians"}
    assert {row.message for row in kept} == {None}
    assert {run.messages for run in study.runs} == {()}


def test_the_reference_of_several_methods_is_one_run(tmp_path: Path) -> None:
    methods = ("plain", "sh", "gs_hider")
    study = read(
        [
            item(tmp_path, method, scene_rows("fox", method, messages=("reef",)), capture="fox", method=method)
            for method in methods
        ]
    )
    assert sorted(run.method for run in study.runs) == ["gs_hider", "plain", "sh"]


def test_of_a_reference_that_was_scored_more_and_less_fully_the_fuller_one_counts(tmp_path: Path) -> None:
    full = scene_rows("fox", "gs_hider", messages=("reef",))
    less = [row for row in scene_rows("fox", "sh", messages=("reef",)) if row.quantity != "ssim"]
    items = [item(tmp_path, "less", less, capture="fox"), item(tmp_path, "full", full, capture="fox")]
    for given in (items, items[::-1]):
        [plain] = [run for run in read(given).runs if run.method == "plain"]
        assert "ssim" in {row.quantity for row in plain.rows}


def test_references_of_several_seeds_are_several_runs(tmp_path: Path) -> None:
    study = read(list(synthetic.fidelity_items(tmp_path)))
    plain = [run for run in study.runs if run.method == "plain" and run.capture == "fox"]
    assert len(plain) == 3
    assert len([run for run in study.runs if run.method == "plain"]) == 5


def test_references_differ_in_their_seeds_alone_whatever_is_hidden_beside_them(tmp_path: Path) -> None:
    """What plain 3DGS shows of a message is a control, and no message of its own."""
    items = []
    for seed, name in enumerate(("reef", "library")):
        rows = scene_rows("fox", "gs_hider", seed, messages=(name,)) + picture_rows("plain", 12.0, name)
        values = {"capture": "fox", "method": "gs_hider", "message": name, "seed": seed}
        items.append(item(tmp_path, name, rows, **values))
    plain = [run for run in read(items).runs if run.method == "plain"]
    assert [(run.seed, run.messages, run.other) for run in plain] == [("0", (), ()), ("1", (), ())]


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


def test_runs_that_differ_in_a_number_alone_are_told_apart_by_it(tmp_path: Path) -> None:
    """Such as a custom method's setting, unknown to the tables. A setting that distinguishes no runs is not named."""

    def own(name: str, cover: float, **values: object) -> Item:
        rows = scene_rows("fox", "gs_hider", cover=cover, messages=("reef",))
        return item(tmp_path, name, rows, capture="fox", method="gs_hider", **values)

    study = read([own("a", 0, hash_levels=4, steps=7), own("b", 1, hash_levels=8, steps=7)])
    runs = study.select(lambda run: run.method == "gs_hider")
    assert [method_title(run) for run in runs] == ["GS-Hider, hash levels 4", "GS-Hider, hash levels 8"]
    assert {run.other for run in runs} == {("steps=7",)}
    study = read([own("c", 0, hash_levels=4, seed=0), own("d", 1, hash_levels=4, seed=1)])
    assert {method_title(run) for run in study.select(lambda run: run.method == "gs_hider")} == {"GS-Hider"}


def test_times_are_told_apart_by_what_tells_their_scores_apart(tmp_path: Path) -> None:
    """Times name no message; that nothing is hidden must not be taken for a setting of the method."""
    rows = {1: scene_rows("fox", "gs_hider", messages=("reef",)), 0: scene_rows("fox", "gs_hider", cover=1)}
    times = {1: 0.023, 0: 0.022}
    scores, timings = [], []
    for hidden in (1, 0):
        values = {"capture": "fox", "method": "gs_hider", "hidden": hidden}
        time = [MetricRow("seconds_per_frame", times[hidden], "s", method="gs_hider")]
        scores.append(item(tmp_path, f"score{hidden}", rows[hidden], **values))
        timings.append(Item(f"time{hidden}", values, "timings", metrics(tmp_path, f"time{hidden}", time)))
    study = read(scores, timings)
    assert [run.settings for run in study.timings] == [(), ()]
    titles = [line.names[0] for line in frame_time(study, read_published()).grids[0].lines]
    assert set(titles) == {"GS-Hider", "GS-Hider, without a message"}


def test_decoders_of_an_unusual_width_are_named(tmp_path: Path) -> None:
    """The usual width depends on the method."""
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


def test_captures_in_folders_of_one_name_are_told_apart(tmp_path: Path) -> None:
    items = [
        item(tmp_path, name.replace("/", " "), scene_rows("fox", "gs_hider"), capture=name, method="gs_hider")
        for name in ("monday/garden", "tuesday/garden", "photos/fox")
    ]
    assert read(items).captures == ("monday/garden", "tuesday/garden", "fox")


def test_some_items_without_a_capture_are_refused(tmp_path: Path) -> None:
    rows = scene_rows("fox", "plain")
    items = [item(tmp_path, "a", rows, capture="fox"), item(tmp_path, "b", rows, scene="fox")]
    with pytest.raises(UserError, match="b: some items do not say what capture they are of; expected a column 'captu"):
        read(items)


def test_times_take_the_method_of_their_item(tmp_path: Path) -> None:
    study = read([], list(synthetic.timing_items(tmp_path)))
    assert {run.method for run in study.timings} == set(synthetic.SECONDS)
    assert study.captures == ("fox", "bonsai", "kitchen")


def test_our_own_weight_is_a_usual_setting_of_ours(tmp_path: Path) -> None:
    """It is 0.1, and the paper's 0.5; stated or left to the method, the setting is the same."""
    stated = {"a": 0.1, "b": None, "c": 0.5}
    study = read(
        [
            item(
                tmp_path,
                name,
                scene_rows("fox", "homogeneous", cover=number / 10, messages=("reef",)),
                capture="fox",
                method="homogeneous",
                lambda_message=weight,
                seed=number,
            )
            for number, (name, weight) in enumerate(stated.items())
        ]
    )
    ours = study.select(lambda run: run.method == "homogeneous")
    assert [method_title(run) for run in ours] == [
        *("Homogeneous GS-Hider", "Homogeneous GS-Hider", "Homogeneous GS-Hider, λ = 0.5")
    ]
    tables = read_published()
    assert [value_of(run, "lambda_message", tables) for run in ours] == [0.1, 0.1, 0.5]


def test_runs_with_fewer_gaussians_are_not_averaged_with_the_others(tmp_path: Path) -> None:
    """The usual bound of a capture is the largest that is stated there."""
    bounds = {("fox", 60_000), ("fox", 15_000), ("bonsai", 150_000)}
    study = read(
        [
            item(
                tmp_path,
                f"{capture} {bound}",
                scene_rows(capture, "gs_hider", cover=bound / 1e6, messages=("reef",)),
                capture=capture,
                method="gs_hider",
                gaussians=bound,
            )
            for capture, bound in sorted(bounds)
        ]
    )
    titles = {(run.capture, run.method): set[str]() for run in study.runs}
    for run in study.runs:
        titles[run.capture, run.method].add(method_title(run))
    assert titles["bonsai", "gs_hider"] == {"GS-Hider"}
    assert titles["fox", "gs_hider"] == {"GS-Hider", "GS-Hider, at most 15,000 Gaussians"}


@pytest.mark.parametrize("setting", ["gaussians", "iterations"])
def test_a_number_that_is_stated_as_text_is_a_setting(tmp_path: Path, setting: str) -> None:
    """The paper's setup has no usual value for these two."""
    rows = scene_rows("fox", "gs_hider", messages=("reef",))
    study = read([item(tmp_path, "a", rows, capture="fox", method="gs_hider", **{setting: "many"})])
    assert [run.settings for run in study.runs if run.method == "gs_hider"] == [((setting, "many"),)]


def test_the_reference_without_a_message_has_the_usual_settings(tmp_path: Path) -> None:
    """Plain 3DGS with fewer Gaussians is not the reference."""
    items = [
        item(
            tmp_path,
            f"{method} {bound}",
            scene_rows("fox", method, cover=change),
            capture="fox",
            method=method,
            gaussians=bound,
        )
        for method, bound, change in (("plain", 60_000, 0.0), ("plain", 15_000, -4.0), ("gs_hider", 60_000, 0.0))
    ]
    chapter = no_message(read(items), read_published())
    lines = {line.names[:2]: line for line in chapter.grids[0].lines if not line.published}
    assert lines["GS-Hider", "PSNR (dB)"].cells[-1].text == "-1.25"
    assert chapter.relations[0].measured.average.mean == pytest.approx(-1.25)


def test_without_the_usual_run_a_larger_one_does_not_stand_for_it(tmp_path: Path) -> None:
    larger = {"feature_dim": 32, "decoder_width": 96}
    items = [
        item(tmp_path, "plain", scene_rows("fox", "plain"), capture="fox", method="plain"),
        item(tmp_path, "larger", scene_rows("fox", "gs_hider", cover=1), capture="fox", method="gs_hider", **larger),
    ]
    beside_plain, beside_usual = no_message(read(items), read_published()).relations
    assert not beside_plain.measured.by_capture
    assert not beside_usual.measured.by_capture


def test_another_weight_makes_nothing_larger(tmp_path: Path) -> None:
    """Rows without a message may all state the λ that they do not use."""
    items = [
        item(
            tmp_path,
            f"{size}",
            scene_rows("fox", "gs_hider", cover=size / 100),
            capture="fox",
            method="gs_hider",
            feature_dim=size,
            lambda_message=1.0,
        )
        for size in (16, 32)
    ]
    _, closer = no_message(read(items), read_published()).relations
    assert closer.measured.on("fox") == pytest.approx(0.16)


def test_of_several_settings_none_is_the_methods_figure(tmp_path: Path) -> None:
    """The lines of the table have each of them; their mean would be a figure of neither."""
    items = [
        item(
            tmp_path,
            f"{weight}",
            scene_rows("fox", "gs_hider", cover=-weight, messages=("reef",)),
            capture="fox",
            method="gs_hider",
            lambda_message=weight,
        )
        for weight in (0.25, 1.0)
    ]
    chapter = fidelity(read(items), read_published())
    assert not any(relation.measured.by_capture for relation in chapter.relations)
    assert {line.names[0] for line in chapter.grids[0].lines} >= {"GS-Hider, λ = 0.25", "GS-Hider, λ = 1"}


def test_a_message_whose_folder_is_a_number_is_no_setting(tmp_path: Path) -> None:
    items = [
        item(
            tmp_path,
            f"{method} {message}",
            scene_rows("fox", method, message=psnr, messages=("reef",)),
            capture="fox",
            method=method,
            message=message,
        )
        for method in ("sh", "gs_hider")
        for message, psnr in (("20240502", 0.0), ("20240503", 4.0))
    ]
    study = read(items)
    assert {run.settings for run in study.runs} == {()}
    assert {run.hides for run in study.select(lambda run: run.method == "sh")} == {"20240502", "20240503"}


def test_experiments_go_together_where_they_differ_in_capture_and_seed_alone() -> None:
    def made(capture: str, method: str, weight: float | None = None) -> Experiment:
        settings = () if weight is None else (("lambda_message", weight),)
        return Experiment(capture, method, "0", (), {}, "", settings)

    usual_one, other, alone = made("fox", "gs_hider"), made("fox", "gs_hider", 0.25), made("fox", "sh", 0.25)
    second = made("bonsai", "gs_hider")
    found = by_method([other, usual_one, second, alone])
    assert found == {"sh": (alone,), "gs_hider": (usual_one, second), "GS-Hider, λ = 0.25": (other,)}
    assert by_method([]) == {}


def test_legal_views_are_those_of_every_message_and_of_one_seed(tmp_path: Path) -> None:
    """One of two messages is trained with two seeds, which do not change which views are legal."""
    rows = {}
    for name, flags in (("reef", (1.0, 1.0)), ("library", (1.0, 0.0))):
        rows[name] = [
            *scene_rows("fox", "gs_hider", cover=len(name) / 100, messages=()),
            *(
                MetricRow(quantity, value, "", view, "test", name, None, "gs_hider")
                for view, flag in zip(("0.png", "8.png"), flags, strict=True)
                for quantity, value in (("psnr", 20.0), ("legal", flag))
            ),
        ]
    study = read(
        [
            item(tmp_path, f"{name} {seed}", rows[name], capture="fox", method="gs_hider", message=name, seed=seed)
            for name, seed in (("reef", 0), ("reef", 1), ("library", 0))
        ]
    )
    [grid] = [grid for grid in fidelity(study, read_published()).grids if "legal views" in grid.caption]
    [line] = [line for line in grid.lines if line.names[0] == "GS-Hider"]
    assert dict(zip(grid.headings, line.cells, strict=True))["Legal views"].text == "3 of 4"


def test_titles_have_settings_of_the_method_alone(tmp_path: Path) -> None:
    """All rows of a table state the same columns; 3DGS+SH has no decoders, and a method of one's own may have none."""

    def titles(**widths: int) -> set[str]:
        items = [
            item(tmp_path, f"{name} {len(widths)}", rows_of(name), capture="fox", method=name[:4], decoder_width=width)
            for name, width in widths.items()
        ]
        return {method_title(run) for run in read(items).runs if run.method != "plain"}

    def rows_of(name: str) -> list[MetricRow]:
        return [replace(row, method="mine") for row in scene_rows("fox", "gs_hider", cover=len(name))]

    assert titles(mine=32) == {"mine"}
    assert titles(mine=32, mine_wide=96) == {"mine, decoders 32 wide", "mine, decoders 96 wide"}
    stated = {"capture": "fox", "feature_dim": 32, "layers": 3, "decoder_width": 32}
    items = [item(tmp_path, name, scene_rows("fox", name), method=name, **stated) for name in ("sh", "decoder")]
    found = {method_title(run) for run in read(items).runs if run.method != "plain"}
    assert found == {"3DGS+SH", "3DGS+Decoder, 3 layers, decoders 32 wide"}
