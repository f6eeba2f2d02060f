"""The chapter on RTWS shows before and after beside the paper's figures; its bars tell good decoders from bad ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from stages.analysis.codec_quality import FOUND, MARKED
from stages.analysis.measurements import Measurement
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.page import owner_page
from stages.analysis.paper.published import read_published
from stages.analysis.paper.rtws import rtws
from stages.analysis.paper.runs import Experiment, Run, Study
from stages.analysis.watermark_trials import (
    BOUND,
    BOUND_AT_99,
    BOUND_BY_SCENE,
    BOUND_BY_SCENE_AT_99,
    CLEAN_CHANNEL,
    COVER_AFTER,
    COVER_BEFORE,
    COVER_CONTROL,
    DETECTED,
    DETECTED_AT_99,
    FALSE_POSITIVES,
    FALSE_POSITIVES_AT_99,
    FALSE_POSITIVES_DISTORTED,
    NEGATIVES_DISTORTED,
    OTHER_SCENES,
    OWN_SCENE,
    PRUNING,
    PSNR_BLACK,
    PSNR_WATERMARK,
    RENDERS,
    SCENES,
    THRESHOLD_AT_99,
    TRIALS,
)
from stages.imaging.distortions import DISTORTIONS
from stages.imaging.metric_table import MetricRow

CLEAN_RENDERS = "renders from before"


def detection(variant: str, method: str, wrong: int) -> Experiment:
    """Under each condition, `wrong` of 4,000 pictures without a watermark are taken for watermarked."""
    shown = {RENDERS: (38.0, 3.0), CLEAN_RENDERS: (38.0, 3.0) if wrong else (3.0, 38.0)}
    rows = [Measurement(PSNR_WATERMARK, pair[0], condition) for condition, pair in shown.items()]
    rows += [Measurement(PSNR_BLACK, pair[1], condition) for condition, pair in shown.items()]
    rows += [Measurement("psnr", 27.0, COVER_BEFORE), Measurement("psnr", 26.5, COVER_AFTER)]
    rows += [Measurement(DETECTED, 0.995, CLEAN_CHANNEL), Measurement(TRIALS, 200, CLEAN_CHANNEL)]
    rows += [Measurement(DETECTED, 0.5, each.name, each.severity) for each in DISTORTIONS]
    for condition in (CLEAN_RENDERS, OWN_SCENE, OTHER_SCENES):
        figures = {TRIALS: 4000, SCENES: 3, FALSE_POSITIVES: wrong, BOUND: (wrong + 3) / 4000, BOUND_BY_SCENE: 0.63}
        rows += [Measurement(quantity, value, condition) for quantity, value in figures.items()]
    return Experiment("fox", method, "0", tuple(rows), {"variant": variant}, "detection[fox]")


def scored(word: str, image: float, variant: str) -> Run:
    rows = (
        MetricRow("psnr", 26.0, "dB", "2.png", "train", None, None, "gs_hider"),
        MetricRow("psnr", image, "dB", "2.png", "train", "boat", None, "gs_hider"),
        MetricRow("hides_image", 1.0, "", "2.png", "train", "boat", None, "gs_hider"),
    )
    return Run("fox", "gs_hider", (), "0", rows, (f"variant={variant}",), f"{word}[fox]")


@pytest.fixture
def chapter() -> Chapter:
    codec = (Measurement(MARKED, 36.5, "photos"), Measurement(FOUND, 33.5, "photos"))
    experiments = (
        detection("paper", "gs_hider", 900),
        detection("clean", "gs_hider", 0),
        detection("paper", "plain", 0),
        Experiment("fox", "", "0", codec, {"variant": "paper"}, "codec[fox]"),
    )
    runs = (scored("before", 42.0, "paper"), scored("after", 39.0, "paper"))
    return rtws(Study(runs, experiments=experiments), read_published())


def figures(chapter: Chapter) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    for line in chapter.grids[0].lines:
        yield line.names, tuple(cell.text for cell in line.cells)


def test_ours_stands_beside_the_papers(chapter: Chapter) -> None:
    found = dict(figures(chapter))
    assert found["GS-Hider, before", "here"] == ("27.00", "42.00", "–")
    assert found["GS-Hider, before", "paper"] == ("26.440", "42.532", "–")
    assert found["GS-Hider, RTWS", "here"] == ("26.50", "39.00", "38.00")
    assert found["GS-Hider, RTWS", "paper"] == ("25.915", "40.513", "39.927")
    assert found["GS-Hider, RTWS, clean renders also black", "here"][1] == "39.00"
    assert found["3DGS, RTWS", "here"] == ("26.50", "–", "38.00")


def test_the_watermarks_psnr_is_said_to_be_that_of_a_gate(chapter: Chapter) -> None:
    notes = " ".join(chapter.grids[0].notes)
    assert "The decoder itself holds the watermark" in notes
    assert "nothing about how much of the picture they carry" in notes


def test_a_good_psnr_does_not_hide_false_positives(chapter: Chapter) -> None:
    verdicts = {relation.text: relation.verdict for relation in chapter.relations}
    assert verdicts["GS-Hider, RTWS: watermark"] == "holds"
    for of in ("other scenes", "the cover without it"):
        bound = f"upper bound on false positives, {of}, in %"
        assert verdicts[f"GS-Hider, RTWS: {bound}"] == "does not hold"
        kept = f"GS-Hider, RTWS, clean renders also black: {bound}"
        assert verdicts[kept] == "by picture: holds; by scene: does not hold", "three scenes say little"
    assert verdicts["GS-Hider, RTWS: message, vs. before"] == "does not hold"
    assert verdicts["GS-Hider, RTWS: cover, vs. before"] == "holds"


def test_every_distortion_and_the_codec_have_a_line(chapter: Chapter) -> None:
    survival, codec = chapter.grids[2:]  # no grid for 99 % detection, which was not measured
    assert len(survival.lines) == 1 + len(DISTORTIONS)
    assert {cell.text for line in survival.lines[1:] for cell in line.cells} == {"50.0 %"}
    assert [cell.text for cell in codec.lines[0].cells] == ["36.50", "33.50"]


def test_the_bar_of_false_positives_holds_where_pictures_and_scenes_are_under_it() -> None:
    """Without a bound by scene at 99 % detection, the bar holds by picture only."""
    found = detection("paper", "gs_hider", 0)
    at_99 = [Measurement(THRESHOLD_AT_99, 0.99, CLEAN_CHANNEL)]
    at_99 += [Measurement(FALSE_POSITIVES_AT_99, 0, OTHER_SCENES), Measurement(BOUND_AT_99, 0.0005, OTHER_SCENES)]
    written, verdicts, holding = [], [], []
    for by_scene in (0.0009, 0.021, None):
        more = [] if by_scene is None else [Measurement(BOUND_BY_SCENE_AT_99, by_scene, OTHER_SCENES)]
        study = Study((), experiments=(replace(found, rows=(*found.rows, *at_99, *more)),))
        page = owner_page(study, ["rtws"], read_published(), "", "")
        text = "GS-Hider, RTWS: upper bound on false positives at 99 % detection, other scenes, in %"
        assert page.relations is not None
        [line] = [line for line in page.relations.lines if line.names[1] == text]
        written.append((line.cells[1].text, line.cells[1].note))
        verdicts.append(line.cells[-1].text)
        [relation] = [each for each in page.chapters[0].relations if each.text == text]
        holding.append(relation.is_found)
        for grid in page.chapters[0].grids:  # else figures.csv has two lines with one name and different values
            assert len(set(grid.headings)) == len(grid.headings), grid.caption
    assert written == [("0.05", "by scene 0.09"), ("0.05", "by scene 2.10"), ("0.05", "by scene –")]
    assert verdicts == [
        "holds",
        "by picture: holds; by scene: does not hold",
        "by picture: holds; by scene: not measured",
    ]
    assert holding == [True, False, False]


def test_a_decoder_that_is_surer_of_its_renders_than_of_anything_else_is_right_at_99_percent() -> None:
    found = detection("paper", "gs_hider", 900)
    at_99 = [Measurement(THRESHOLD_AT_99, 0.9986, CLEAN_CHANNEL)]
    for condition, wrong in ((OTHER_SCENES, 0), (OWN_SCENE, 9)):
        at_99 += [Measurement(FALSE_POSITIVES_AT_99, wrong, condition)]
        at_99 += [Measurement(BOUND_AT_99, (wrong + 3) / 4000, condition)]
    chapter = rtws(Study((), experiments=(replace(found, rows=(*found.rows, *at_99)),)), read_published())
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith("At 99 %")]
    assert [cell.text for cell in grid.lines[0].cells] == ["0.9986", "–", "0", "0.00075", "–", "9", "0.003", "–"]
    verdicts = {relation.text: relation.verdict for relation in chapter.relations}
    bound = "GS-Hider, RTWS: upper bound on false positives"
    assert verdicts[f"{bound} at 99 % detection, other scenes, in %"].startswith("by picture: holds")
    assert "by picture: does not hold" in verdicts[f"{bound} at 99 % detection, the cover without it, in %"]
    assert verdicts[f"{bound}, other scenes, in %"] == "does not hold"


def test_renders_that_the_threshold_of_99_percent_finds_are_held_to_the_bar() -> None:
    """Other renders set the threshold, so it may detect fewer of these."""
    found = detection("paper", "gs_hider", 0)
    at_99 = (Measurement(THRESHOLD_AT_99, 0.9986, CLEAN_CHANNEL), Measurement(DETECTED_AT_99, 0.97, CLEAN_CHANNEL))
    chapter = rtws(Study((), experiments=(replace(found, rows=(*found.rows, *at_99)),)), read_published())
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith("At 99 %")]
    assert (grid.headings[1], grid.lines[0].cells[1].text) == ("Renders detected", "97.0 %")
    verdicts = {relation.text: relation.verdict for relation in chapter.relations}
    assert verdicts["GS-Hider, RTWS: renders detected, in %"] == "holds"
    assert verdicts["GS-Hider, RTWS: renders detected at 99 % detection, in %"] == "does not hold"


def test_seeds_of_a_capture_are_averaged() -> None:
    found = [detection("paper", "gs_hider", wrong) for wrong in (0, 900)]
    for experiments in ((found[0], replace(found[1], seed="1")), (replace(found[1], seed="1"), found[0])):
        chapter = rtws(Study((), experiments=experiments), read_published())
        bounds = [relation.measured.on("fox") for relation in chapter.relations if "other scenes" in relation.text]
        assert bounds == pytest.approx([100 * (903 + 3) / 4000 / 2])


def test_averages_over_fewer_captures_than_others_say_so() -> None:
    """Else the difference between captures would pass for what a watermark costs."""
    found = detection("paper", "gs_hider", 0)
    grain = replace(found, stage="detection_grain[fox]")
    study = Study((), experiments=(found, replace(found, capture="kitchen"), grain))
    grids = {grid.caption: grid for grid in rtws(study, read_published()).grids}
    lines = {line.names: line.cells for line in grids["RTWS: PSNR (dB), averages over the captures"].lines}
    notes = {names: cells[0].note for names, cells in lines.items()}
    assert notes["GS-Hider, RTWS", "here"] == ""
    assert notes["GS-Hider, grain, read by its owner", "here"] == "on 1 capture"
    assert [cell.note for cell in grids["Renders detected"].lines[0].cells] == ["", "on 1 capture"]


def test_a_distortion_that_one_capture_lacks_is_averaged_over_the_others() -> None:
    found = detection("paper", "gs_hider", 0)
    less = replace(found, capture="kitchen", rows=tuple(row for row in found.rows if row.quantity != DETECTED))
    grids = rtws(Study((), experiments=(found, less)), read_published()).grids
    [survival] = [grid for grid in grids if grid.caption == "Renders detected"]
    assert {(line.cells[0].text, line.cells[0].note) for line in survival.lines[1:]} == {("50.0 %", "on 1 capture")}


def test_one_measurement_that_two_rows_share_stands_once() -> None:
    grain = replace(detection("paper", "gs_hider", 0), stage="detection_grain[fox]")
    twice = (grain, replace(grain, values={"variant": "clean"}))
    once, both = (rtws(Study((), experiments=each), read_published()).grids for each in (twice[:1], twice))
    assert str(both) == str(once)  # NaN is not equal to itself


def test_nothing_measured_is_an_empty_chapter() -> None:
    assert rtws(Study(()), read_published()).grids == ()


def test_stages_with_grain_are_a_variant_of_their_own() -> None:
    found = replace(detection("paper", "gs_hider", 0), stage="detection_grain[fox]")
    runs = (scored("before", 42.0, "paper"), scored("after_grain", 41.5, "paper"))
    chapter = rtws(Study(runs, experiments=(found,)), read_published())
    names = dict(figures(chapter))
    assert names["GS-Hider, grain, read by its owner", "here"] == ("26.50", "41.50", "–"), "no picture is decoded"
    assert not any("grain" in each.text and "watermark" in each.text for each in chapter.relations)


def test_an_imprint_is_held_to_the_papers_bars() -> None:
    found = replace(detection("paper", "gs_hider", 0), stage="detection_imprint[fox]")
    runs = (scored("before", 42.0, "paper"), scored("after_imprint", 41.5, "paper"))
    chapter = rtws(Study(runs, experiments=(found,)), read_published())
    assert dict(figures(chapter))["GS-Hider, imprint", "here"] == ("26.50", "41.50", "38.00")
    assert any("imprint: watermark" in each.text for each in chapter.relations)


def test_what_is_shown_to_the_last_bit_has_a_finite_mean() -> None:
    found = detection("paper", "gs_hider", 0)
    exact = Measurement(PSNR_WATERMARK, float("inf"), RENDERS)
    chapter = rtws(Study((), experiments=(replace(found, rows=(*found.rows, exact)),)), read_published())
    assert dict(figures(chapter))["GS-Hider, RTWS", "here"][2] == "68.50"


def test_what_is_taken_for_it_after_a_distortion_stands_beside_what_is_found() -> None:
    """Counts of captures are added; without such measurements there is no column, or no figure."""
    found = detection("paper", "gs_hider", 0)
    distorted = DISTORTIONS[0]
    counts = {NEGATIVES_DISTORTED: 300, FALSE_POSITIVES_DISTORTED: 6}
    rows = [Measurement(each, value, distorted.name, distorted.severity) for each, value in counts.items()]
    measured = [replace(found, capture=capture, rows=(*found.rows, *rows)) for capture in ("fox", "bonsai")]
    earlier = detection("paper", "plain", 0)
    experiments = (*measured, earlier, replace(found, capture="kitchen"))
    chapter = rtws(Study((), experiments=experiments), read_published())
    [grid] = [grid for grid in chapter.grids if grid.caption == "Renders detected"]
    assert grid.headings == ("GS-Hider, RTWS", "GS-Hider, RTWS: false positives", "3DGS, RTWS")
    assert [(cell.text, cell.note) for cell in (line.cells[1] for line in grid.lines[:3])] == [
        ("0.00 %", "0 of 12,000"),
        ("2.00 %", "12 of 600"),
        ("–", ""),
    ]
    assert len(grid.notes) == 2
    grids = rtws(Study((), experiments=(earlier,)), read_published()).grids
    [before] = [grid for grid in grids if grid.caption == "Renders detected"]
    assert (before.headings, len(before.notes)) == (("3DGS, RTWS",), 1)


def test_the_cost_is_taken_against_a_container_that_was_trained_as_long_without_the_watermark() -> None:
    found = detection("paper", "gs_hider", 0)
    controlled = replace(found, rows=(*found.rows, Measurement("psnr", 28.0, COVER_CONTROL)))
    grain = replace(found, stage="detection_grain[fox]")
    runs = (scored("before", 38.0, "paper"), scored("control", 42.0, "paper"), scored("after", 39.0, "paper"))
    chapter = rtws(Study(runs, experiments=(controlled, grain)), read_published())
    assert dict(figures(chapter))["GS-Hider, trained further without it", "here"] == ("28.00", "42.00", "–")
    verdicts = {relation.text: relation.verdict for relation in chapter.relations}
    for picture in ("cover", "message"):
        assert verdicts[f"GS-Hider, RTWS: {picture}, vs. before"] == "holds"
        assert verdicts[f"GS-Hider, RTWS: {picture}, vs. training as long without it"] == "does not hold"
    assert not any("grain" in text and "as long" in text for text in verdicts), "nothing is trained for it"


def test_attacked_containers_have_lines() -> None:
    found = detection("paper", "gs_hider", 0)
    pruned = Measurement(DETECTED, 0.25, PRUNING, 0.25)
    survival = rtws(Study((), experiments=(replace(found, rows=(*found.rows, pruned)),)), read_published()).grids[2]
    assert [cell.text for cell in survival.lines[-1].cells] == ["25.0 %"]
    assert survival.lines[-1].names == ("container: pruned at random, share 0.25",)
