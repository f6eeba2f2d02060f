"""An average over fewer captures than others says so, and runs that differ in a setting are not averaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import create, load
from pipeline.stage import Item
from stages.analysis.attacks.catalogue import UNATTACKED
from stages.analysis.measurements import KIND, Measurement, write_measurements
from stages.analysis.paper.ablations import ablations
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.fidelity import fidelity
from stages.analysis.paper.grid import Cell
from stages.analysis.paper.probes import probes
from stages.analysis.paper.published import read_published
from stages.analysis.paper.robustness import robustness
from stages.analysis.paper.runs import Columns, Experiment, Run, Settings, Study, by_method, read_study
from stages.analysis.probes import OWN, run_name
from stages.imaging.metric_table import MetricRow, write_rows

Cells = dict[tuple[str, ...], dict[str, Cell]]


def cells(chapter: Chapter, caption: str) -> Cells:
    """Cells by line and heading, for our own lines of the grid whose caption starts with `caption`."""
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith(caption)]
    return {line.names: dict(zip(grid.headings, line.cells, strict=True)) for line in grid.lines if not line.published}


def run(capture: str, method: str, cover: float, message: float, settings: Settings = ()) -> Run:
    rows = [
        MetricRow("psnr", value, "dB", "0.png", "test", name, method=method)
        for name, value in ((None, cover), ("statue", message))
    ]
    return Run(capture, method, settings, "0", tuple(rows))


def attacked(capture: str, method: str, cover: float, message: float, spread: float = 0.0) -> Experiment:
    """Random pruning with two seeds, whose messages differ by `spread`."""

    def rows(condition: str, share: float | None, seed: int | None, lost: float) -> list[Measurement]:
        figures = ((None, cover - lost), ("statue", message - lost / 2 - spread * (seed or 0)))
        return [
            Measurement("psnr", value, condition, share, seed, None, "test", name, method) for name, value in figures
        ]

    found = rows(UNATTACKED, None, None, 0.0)
    for seed in (0, 1):
        found += [*rows("random_pruning", 0.05, seed, 0.5), *rows("random_pruning", 0.25, seed, 2.0)]
    return Experiment(capture, method, "0", tuple(found), {})


def test_an_ablation_of_which_a_row_failed_says_of_how_many_captures_its_average_is() -> None:
    lighter: Settings = (("lambda_message", 1.0),)
    runs = (
        run("fox", "gs_hider", 30, 20),
        run("kitchen", "gs_hider", 20, 14),
        run("fox", "gs_hider", 29, 21, lighter),
    )
    found = cells(ablations(Study(runs), read_published()), "GS-Hider: λ, test views")
    written = {names[0]: line["Cover PSNR (dB)"] for names, line in found.items()}
    assert [(value, cell.text, cell.note) for value, cell in written.items()] == [
        ("0.5", "25.00", ""),
        ("1", "29.00", "on 1 capture"),
    ]


def test_attacks_of_which_a_row_failed_say_of_how_many_captures_their_averages_are() -> None:
    ours, theirs = "Homogeneous GS-Hider", "GS-Hider"
    tried = (
        attacked("fox", "homogeneous", 32, 22),
        attacked("kitchen", "homogeneous", 20, 20, spread=1.0),
        attacked("fox", "gs_hider", 30, 19),
    )
    chapter = robustness(Study((), experiments=tried), read_published())
    pruned = cells(chapter, "Pruned Gaussians")
    assert pruned["Nothing pruned", theirs, "here"]["Cover: PSNR (dB)"].note == "on 1 capture"
    assert pruned["Nothing pruned", ours, "here"]["Cover: PSNR (dB)"].note == ""
    for caption, line in (
        ("What is left of the message, as found", "No attack"),
        ("What is left of the message, as found", "Random pruning"),
        ("What attackers gain, as found", "Random pruning"),
    ):
        found = cells(chapter, caption)[(line,)]
        assert "on 1 capture" in found[theirs].note
        assert "on 1 capture" not in found[ours].note
    assert ("Random pruning", f"{theirs} (on 1 capture) · Cover") in cells(chapter, "The points of the curves")
    [bar] = [each for each in chapter.relations if "by more than the spread, as found" in each.text]
    assert bar.measured.by_capture.keys() == {"fox"}
    assert bar.bound == pytest.approx(0, abs=1e-9), "kitchen's seeds spread, and are not what is compared"


def test_settings_of_a_method_of_ones_own_tell_its_runs_and_its_experiments_apart(tmp_path: Path) -> None:
    """A column may hold a mapping of such settings, as `workflows/README.md` shows."""

    def item(name: str, levels: int, message: float, stage: str) -> Item:
        values = {"capture": "fox", "method": "mine", "seed": 0, "own": {"levels": levels}, "clean_seed": levels}
        with create(tmp_path / name, "metrics" if stage == "scores" else KIND, private=True) as writer:
            if stage == "scores":
                write_rows(writer, run("fox", "mine", 30, message).rows)
            else:
                write_measurements(writer, attacked("fox", "mine", 30, message).rows)
        return Item(name, values, stage, load(tmp_path / name))

    scores = [item(f"scores {levels}", levels, message, "scores") for levels, message in ((2, 22.0), (4, 12.0))]
    tried = [item(f"attacked {levels}", levels, message, "attacked") for levels, message in ((2, 22.0), (4, 12.0))]
    study = read_study(scores, [], Columns(), read_published().setup, tried)
    titles = {line.names[0] for line in fidelity(study, read_published()).grids[0].lines if not line.published}
    assert {"mine, levels 2", "mine, levels 4"} <= titles
    assert [*by_method(study.experiments)] == ["mine, levels 2", "mine, levels 4"]


def test_probes_are_of_every_method_and_of_each_setting_by_itself() -> None:
    def probed(method: str, value: float, settings: Settings = ()) -> Run:
        name = run_name(method, OWN)
        rows = (
            MetricRow("psnr_covered", value, "dB", "0.png", "test", "statue", method=name),
            MetricRow("psnr_constant", 12.0, "dB", "0.png", "test", "statue", method=name),
        )
        return Run("fox", name, settings, "0", rows)

    study = Study((probed("mine", 18), probed("gs_hider", 10, (("lambda_message", 1.0),)), probed("gs_hider", 20)))
    found = cells(probes(study, read_published()), "What the message decoder shows")
    own = {title: line["fox"].text for (title, features, _), line in found.items() if features == OWN}
    assert own == {"GS-Hider": "20.00", "GS-Hider, λ = 1": "10.00", "mine": "18.00"}
    assert [*own] == ["GS-Hider", "GS-Hider, λ = 1", "mine"]
    assert not fidelity(study, read_published()).grids, "a probe is no row of Table 1"
