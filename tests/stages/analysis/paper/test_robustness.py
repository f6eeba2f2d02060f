"""The chapter on robustness: the paper's prunings beside ours, areas, gains, remedies, and which bars are met."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from stages.analysis.attacks.catalogue import ATTACKS, ONE_COLOUR, UNATTACKED, restored
from stages.analysis.measurements import Measurement
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import Grid
from stages.analysis.paper.page import owner_page, write_page
from stages.analysis.paper.published import read_published
from stages.analysis.paper.purification import VIEW_WEIGHTS
from stages.analysis.paper.robustness import robustness
from stages.analysis.paper.runs import Experiment, Study

BEFORE = {"homogeneous": (32.0, 25.0), "gs_hider": (30.0, 24.0), "sh": (31.0, 22.0)}
SEEDS = (0, 1, 2)
FLOOR = 13.0
FOUND, REGISTERED = "as found", "after registration with the published container"


def rows(
    method: str, condition: str, severity: float | None, seed: int | None, cover: float, message: float
) -> Iterator[Measurement]:
    """Figures of cover and message after these losses, in dB."""
    before = BEFORE[method]
    for name, value in ((None, before[0] - cover), ("statue", before[1] - message)):
        for quantity, figure in (("psnr", value), ("ssim", value / 40)):
            yield Measurement(quantity, figure, condition, severity, seed, None, "test", name, method)


def experiment(capture: str, method: str) -> Experiment:
    """Random pruning takes a little more of ours with each seed; unread directions cost the cover of GS-Hider only.

    Permuted channels take more than there is, and registration restores nearly all; pruned messages it makes worse.
    """
    found = list(rows(method, UNATTACKED, None, None, 0, 0))
    found.append(Measurement(ONE_COLOUR, FLOOR, UNATTACKED, None, None, None, "test", "statue", method))
    for share, cover in ((0.05, 0.4), (0.10, 0.9), (0.15, 1.4), (0.25, 2.6)):
        found += rows(method, "sequential_pruning", share, 0, 0.01 if share < 0.2 else 0.2, 0)
        for seed in SEEDS:
            extra = 0.1 * (seed - 1) if method == "homogeneous" else 0.0
            found += rows(method, "random_pruning", share, seed, cover, cover / 2 + extra)
            found += rows(method, restored("random_pruning"), share, seed, cover, cover / 2 + extra + 1)
    for count in (1, 4, 8):
        cost = 0.0 if method == "homogeneous" else 0.5 * count
        if method != "sh":
            found += rows(method, "unread_directions", count, 0, cost, count)
            found += rows(method, restored("unread_directions"), count, 0, 0, count / 2)
    if method != "sh":
        found += rows(method, "channel_permutation", 16, 0, 0, 20 if method == "homogeneous" else 16)
        found += rows(method, restored("channel_permutation"), 16, 0, 0, 0.1)
    found += rows(method, "view_weight_pruning", 0.2, 0, 1.0, 6.0)
    return Experiment(capture, method, "0", tuple(found), {}, f"attacked[{capture},{method}]")


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(
        (), experiments=tuple(experiment(capture, method) for capture in ("fox", "bonsai") for method in BEFORE)
    )


@pytest.fixture(scope="module")
def chapter(study: Study) -> Chapter:
    return robustness(study, read_published())


def written(chapter: Chapter, caption: str) -> dict[tuple[str, ...], dict[str, str]]:
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith(caption)]
    return {
        line.names: {heading: cell.text for heading, cell in zip(grid.headings, line.cells, strict=True)}
        for line in grid.lines
    }


def test_the_papers_prunings_stand_beside_ours(chapter: Chapter) -> None:
    found = written(chapter, "Pruned Gaussians")
    assert found["Random, 25 %", "GS-Hider", "here"]["Cover: PSNR (dB)"] == "27.40"
    assert found["Random, 25 %", "GS-Hider", "paper"] == {
        "Cover: PSNR (dB)": "23.004",
        "Cover: SSIM": "0.697",
        "Cover: LPIPS": "0.319",
        "Message: PSNR (dB)": "23.661",
        "Message: SSIM": "0.741",
    }
    assert found["Nothing pruned", "GS-Hider", "paper"]["Message: PSNR (dB)"] == "25.178"
    assert ("Sequential, 15 %", "Homogeneous GS-Hider", "here") in found


def test_areas_are_over_what_both_reach(chapter: Chapter) -> None:
    found = written(chapter, f"What is left of the message, {FOUND}")
    pruned = found[("Random pruning",)]
    assert pruned["Cover's loss up to"] == "2.60 dB"
    assert pruned["GS-Hider"] == "23.35"
    assert "±" in pruned["Homogeneous GS-Hider"]
    unread = found[("Unread directions removed",)]
    assert unread["Cover's loss up to"] == "0.25 dB"
    assert unread["Homogeneous GS-Hider"] == "17.00"
    assert unread["GS-Hider"] == "23.75"
    assert unread["3DGS+SH"] == ATTACKS["unread_directions"].needs


def test_an_attack_that_costs_one_cover_nothing_does_not_seem_to_spare_what_it_takes_of_the_other() -> None:
    """Of ours, a tenth of a decibel buys 5 dB of the message: half of them on the way there, all of them beyond."""
    experiments = []
    for method, cost in (("homogeneous", 0.1), ("gs_hider", 0.0)):
        found = [*rows(method, UNATTACKED, None, None, 0, 0), *rows(method, "reoptimisation", 100, 0, cost, 5)]
        experiments.append(Experiment("fox", method, "0", tuple(found), {}))
    chapter = robustness(Study((), experiments=tuple(experiments)), read_published())
    left = written(chapter, f"What is left of the message, {FOUND}")[("Re-optimisation",)]
    assert (left["Homogeneous GS-Hider"], left["GS-Hider"]) == ("21.00", "19.00")


def test_where_an_attack_has_nothing_to_act_on_it_is_said() -> None:
    tried = {
        "decoder": ("jpeg",),
        "gs_hider": ("stripping", "feature_rotation"),
        "sh": ("stripping",),
    }
    experiments = []
    for method, names in tried.items():
        found = [*rows("sh", UNATTACKED, None, None, 0, 0)]
        for name in names:
            found += rows("sh", name, 1.0, 0, 1.0, 1.0)
        own = tuple(replace(row, method=method) for row in found)
        experiments.append(Experiment("fox", method, "0", own, {}))
    chapter = robustness(Study((), experiments=tuple(experiments)), read_published())
    found = written(chapter, f"What is left of the message, {FOUND}")
    spared = {
        ("JPEG of the renders", "GS-Hider"): "jpeg",
        ("JPEG of the renders", "3DGS+SH"): "jpeg",
        ("Stripping", "3DGS+Decoder"): "stripping",
        ("Feature rotation", "3DGS+Decoder"): "feature_rotation",
        ("Feature rotation", "3DGS+SH"): "feature_rotation",
    }
    for (title, method), attack in spared.items():
        assert found[title,][method] == ATTACKS[attack].needs
    assert float(found["JPEG of the renders",]["3DGS+Decoder"]) < BEFORE["sh"][1]


def test_what_a_message_loses_stands_beside_what_is_left_of_it(chapter: Chapter) -> None:
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith(f"What is left of the message, {FOUND}")]
    [unread] = [line for line in grid.lines if line.names == ("Unread directions removed",)]
    ours = dict(zip(grid.headings, unread.cells, strict=True))["Homogeneous GS-Hider"]
    assert (ours.text, ours.note) == ("17.00", "-8.00")
    assert any("loses more of its message than GS-Hider under 2 of 5" in note for note in grid.notes), grid.notes


def test_the_owner_keeps_the_better_of_both_readings(chapter: Chapter) -> None:
    found = written(chapter, f"What is left of the message, {FOUND}")
    registered = written(chapter, f"What is left of the message, {REGISTERED}")
    assert registered["Unread directions removed",]["Homogeneous GS-Hider"] == "21.00"
    assert registered["Channels permuted, scene decoder with them",]["Homogeneous GS-Hider"] == "24.90"
    same = ("Random pruning", "Sequential pruning", "View-weight pruning", "No attack")
    assert all(registered[name,] == found[name,] for name in same), "no worse reading counts"


def test_a_message_that_is_gone_counts_as_one_colour(chapter: Chapter) -> None:
    permuted = ("Channels permuted, scene decoder with them",)
    left = written(chapter, f"What is left of the message, {FOUND}")[permuted]
    assert (left["Homogeneous GS-Hider"], left["GS-Hider"]) == ("13.00", "13.00")
    assert written(chapter, f"What attackers gain, {FOUND}")[permuted]["Homogeneous GS-Hider"] == "12.00"
    points = written(chapter, "The points of the curves")
    raw = points["Channels permuted, scene decoder with them", "Homogeneous GS-Hider · Message"]
    assert raw["Point 1"] == "5.00"
    assert any("one colour" in note for grid in chapter.grids for note in grid.notes)


def test_the_weakest_attack_is_named_with_its_reason(chapter: Chapter) -> None:
    found, registered = chapter.tiles
    assert (found.value, registered.value) == ("12.00 dB", "5.00 dB")
    for reading, weakest in ((FOUND, "channels permuted"), (REGISTERED, "view-weight pruning")):
        [grid] = [grid for grid in chapter.grids if grid.caption.startswith(f"What attackers gain, {reading}")]
        assert any(f"Homogeneous GS-Hider is weakest under {weakest}" in note for note in grid.notes)


def test_bars(chapter: Chapter) -> None:
    verdicts = {relation.text: relation.verdict for relation in chapter.relations}
    assert verdicts["GS-Hider, 15 % sequential: change of the cover"] == "holds"
    assert verdicts["GS-Hider, 25 % at random: change of the cover"] == "holds"
    assert verdicts["GS-Hider, 25 % at random: change of the message"] == "holds"
    bounds = {relation.text: relation.bound for relation in chapter.relations}
    for picture, at_random in (("cover", -2.9), ("message", -1.6)):
        assert bounds[f"GS-Hider, 15 % sequential: change of the {picture}"] == -0.05
        assert bounds[f"GS-Hider, 25 % at random: change of the {picture}"] == at_random
    ours = "Homogeneous GS-Hider not below GS-Hider by more than the spread, "
    assert verdicts[f"{ours}as found: random pruning"] == "holds"
    assert verdicts[f"{ours}as found: unread directions removed"] == "does not hold"
    assert verdicts[f"{ours}registered: unread directions removed"] == "does not hold"
    assert verdicts[f"{ours}registered: channels permuted, scene decoder with them"] == "holds"


@pytest.mark.parametrize("captures", [("fox",), ("fox", "bonsai")])
@pytest.mark.parametrize(("under", "verdict"), [(0.04, "holds"), (0.2, "does not hold")])
def test_ours_may_be_under_gs_hider_by_the_spread_and_no_more(
    under: float, verdict: str, captures: tuple[str, ...]
) -> None:
    """The spread is that of three seeds that differ by 0.1 dB; the average of two captures spreads less."""

    def weakened(method: str, extra: float, capture: str) -> Experiment:
        found = list(rows("gs_hider", UNATTACKED, None, None, 0, 0))
        for seed in SEEDS:
            found += rows("gs_hider", "random_pruning", 0.25, seed, 2.0, 4.0 + extra + 0.1 * (seed - 1))
        return Experiment(capture, method, "0", tuple(replace(row, method=method) for row in found), {})

    # The area averages the loss from 0 at no cost to its end, so a loss at the end counts half.
    both = (("gs_hider", 0.0), ("homogeneous", 2 * under))
    compared = Study((), experiments=tuple(weakened(*each, capture) for capture in captures for each in both))
    relations = robustness(compared, read_published()).relations
    [bar] = [each for each in relations if "by more than the spread, as found: random pruning" in each.text]
    spread = 0.1 / 2
    assert bar.bound == pytest.approx(-math.hypot(spread, spread) / math.sqrt(len(captures)))
    assert bar.measured.on("fox") == pytest.approx(-under)
    assert bar.verdict == verdict


def test_a_container_of_another_weight_is_no_seed(study: Study) -> None:
    other = replace(experiment("fox", "homogeneous"), settings=(("lambda_message", 0.3),))
    found = written(
        robustness(replace(study, experiments=(*study.experiments, other)), read_published()),
        f"What is left of the message, {FOUND}",
    )
    before = written(robustness(study, read_published()), f"What is left of the message, {FOUND}")
    for attack, cells in before.items():
        assert {name: found[attack][name] for name in cells} == cells
        assert "Homogeneous GS-Hider, λ = 0.3" in found[attack]


def test_a_sealed_container_stands_beside_the_same_unsealed_and_is_held_to_the_same_bars(study: Study) -> None:
    sealed = tuple(
        replace(experiment(capture, "homogeneous"), settings=(("sealed", "True"),)) for capture in ("fox", "bonsai")
    )
    chapter = robustness(replace(study, experiments=(*study.experiments, *sealed)), read_published())
    for caption in ("Pruned Gaussians", f"What is left of the message, {FOUND}", f"What attackers gain, {FOUND}"):
        [grid] = [grid for grid in chapter.grids if grid.caption.startswith(caption)]
        shown = {*grid.headings, *(name for line in grid.lines for name in line.names)}
        assert {"Homogeneous GS-Hider", "Homogeneous GS-Hider, sealed"} <= shown
    [note] = {note for grid in chapter.grids for note in grid.notes if note.startswith("Sealed:")}
    assert "opens what is left of it by means of what was published" in note
    texts = [relation.text for relation in chapter.relations]
    of_sealed = [text for text in texts if text.startswith("Homogeneous GS-Hider, sealed")]
    assert [text.replace(", sealed", "") for text in of_sealed] == [
        text for text in texts if text.startswith("Homogeneous GS-Hider") and text not in of_sealed
    ]


def test_without_a_sealed_container_nothing_is_said_of_seals(chapter: Chapter) -> None:
    assert not [note for grid in chapter.grids for note in grid.notes if "ealed" in note]


def test_purification(chapter: Chapter) -> None:
    found = written(chapter, "View-weight pruning")
    assert found["Homogeneous GS-Hider", "here"]["One by one"] == "5.00"
    assert found["GS-Hider", "GSPure"]["By clusters, no floor"] == "10.16"
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith("View-weight pruning")]
    assert any("GSPure (AAAI 2026) itself was not reproduced" in note for note in grid.notes)


def test_what_a_floor_leaves_to_gain_is_said_and_gains_without_it_stand_beside() -> None:
    """On the fox, GS-Hider's message loses 20 dB, of which 11 count; on bonsai it starts below one colour."""
    killed = []
    for capture, floor in (("fox", FLOOR), ("bonsai", 24.5)):
        found = [*rows("gs_hider", UNATTACKED, None, None, 0, 0)]
        found.append(Measurement(ONE_COLOUR, floor, UNATTACKED, message="statue", method="gs_hider"))
        for attack in VIEW_WEIGHTS:
            found += rows("gs_hider", attack, 0.2, 0, 1.0, 20.0)
        killed.append(Experiment(capture, "gs_hider", "0", tuple(found), {}))
    chapter = robustness(Study((), experiments=tuple(killed)), read_published())
    beside = written(chapter, "View-weight pruning")["GS-Hider", "here"]
    assert beside == {
        "One by one": "4.50",
        "By clusters": "4.50",
        "Most it can lose": "5.50",
        "One by one, no floor": "19.00",
        "By clusters, no floor": "19.00",
    }
    assert written(chapter, f"What attackers gain, {FOUND}")["Most it can lose",]["GS-Hider"] == "5.50"
    for grid in chapter.grids:
        if grid.caption.startswith(("View-weight pruning", "What attackers gain")):
            assert any("GS-Hider shows no more than one colour on bonsai" in note for note in grid.notes)


def test_readings_after_registration_are_there_as_they_were_made(chapter: Chapter) -> None:
    found = written(chapter, f"The message at every point, {REGISTERED}")
    assert found["Unread directions removed", "GS-Hider"]["Point 5"] == "20.00"
    assert found["Random pruning", "3DGS+SH"]["Point 5"] == "19.70"
    assert found["Channels permuted, scene decoder with them", "GS-Hider"]["Point 2"] == "", "it costs no cover"


def test_severities_of_curves_are_of_all_that_was_measured(chapter: Chapter) -> None:
    found = written(chapter, "The points of the curves")
    assert found["Random pruning", "GS-Hider · Cover"]["Severities"] == "0.05 to 0.25 (4)"
    assert found["Channels permuted, scene decoder with them", "GS-Hider · Cover"]["Severities"] == "16 (1)"


def test_beside_severities_stands_how_many_were_measured_at_least_on_each_container(study: Study) -> None:
    whole = [each for each in study.experiments if each.method == "gs_hider"]
    fewer = replace(whole[0], rows=tuple(row for row in whole[0].rows if row.severity != 0.1))
    chapter = robustness(Study((), experiments=(fewer, *whole[1:])), read_published())
    found = written(chapter, "The points of the curves")
    assert found["Random pruning", "GS-Hider · Cover"]["Severities"] == "0.05 to 0.25 (3)"


def test_one_chart_an_attack_and_a_curve_a_method(chapter: Chapter) -> None:
    charts = {chart.title: [name for name, _ in chart.lines] for chart in chapter.charts}
    assert charts["Random pruning"] == ["3DGS+SH", "GS-Hider", "Homogeneous GS-Hider"]
    assert charts["Unread directions removed"] == ["GS-Hider", "Homogeneous GS-Hider"]
    looks = {chart.title: chart.looks for chart in chapter.charts}
    assert (looks["Random pruning"], looks["Unread directions removed"]) == ((0, 1, 2), (1, 2))
    assert len(charts) == 5


def test_figures_say_where_they_come_from(chapter: Chapter) -> None:
    notes = [note for grid in chapter.grids for note in grid.notes]
    assert any("attacked[fox,gs_hider]" in note for note in notes)


def test_the_page_is_written_and_without_measurements_says_so(study: Study) -> None:
    measured, nothing = (
        owner_page(each, ["robustness"], read_published(), "robustness", "") for each in (study, Study(()))
    )
    assert isinstance(measured.relations, Grid)
    assert nothing.nothing in write_page(nothing)
    assert nothing.nothing not in write_page(measured)


def test_a_message_that_reads_worse_than_one_colour_counts_as_one_before_attacks_too() -> None:
    """Otherwise a rigid motion, which changes nothing, would seem to leave more than there was."""
    whole = experiment("fox", "sh")
    rows_above = [replace(row, value=22.5) if row.quantity == ONE_COLOUR else row for row in whole.rows]
    study = Study((), experiments=(replace(whole, rows=tuple(rows_above)),))
    found = written(robustness(study, read_published()), f"What is left of the message, {FOUND}")
    assert found["No attack",]["3DGS+SH"] == "22.50"
