"""Verdicts on detectors: compared with two trainings that hide nothing, capture by capture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from stages.analysis.learned_detection import TRAINING_SCENES
from stages.analysis.measurements import Measurement
from stages.analysis.paper.detection import (
    AS_IN_THE_PAPER,
    CHANCE,
    HIDING,
    RENDERING,
    area_cell,
    area_of,
    excess_cell,
    excess_of,
    scores_of,
    verdict,
)
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Experiment, Study
from stages.analysis.paper.steganalysis import steganalysis
from stages.analysis.paper.steganalysis_tables import AREA_NOTE, EXCESS
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION

LOGIT = "learned_on_renders"
VIEWS = 60


def seen(capture: str, hiding: float, chance: float | None) -> Experiment:
    """Logits that order these shares of the pairs of views correctly, in each of the two comparisons."""
    logits = {CLEAN: np.linspace(0, 1, VIEWS), HIDDEN: _above(hiding)}
    if chance is not None:
        logits[CLEAN_AGAIN] = _above(chance)
    rows = [Measurement(LOGIT, float(value), condition) for condition, all_ in logits.items() for value in all_]
    return Experiment(capture, "gs_hider", "0", tuple(rows), {})


def _above(share: float) -> np.ndarray:
    """Values; this share of them lies above the range 0 to 1 of clean ones, the rest below it."""
    return np.where((np.arange(VIEWS) * 7 % VIEWS + 0.5) / VIEWS < share, 2.0, -1.0)


def test_controls_on_both_sides_of_chance_are_as_far_from_it() -> None:
    controls = [seen("fox", 0.7, 0.75), seen("bonsai", 0.7, 0.25)]
    assert area_of(controls, LOGIT, CHANCE).value == pytest.approx(0.75)
    assert verdict(controls, LOGIT) == "distinguished, but not significantly better than two that hide nothing"


def test_controls_near_chance_do_not_excuse() -> None:
    assert verdict([seen("fox", 0.95, 0.55), seen("bonsai", 0.95, 0.45)], LOGIT) == "distinguished"


def scored(hiding: np.ndarray, chance: np.ndarray, clean: np.ndarray) -> Experiment:
    logits = {CLEAN: clean, HIDDEN: hiding, CLEAN_AGAIN: chance}
    rows = [Measurement(LOGIT, float(value), condition) for condition, each in logits.items() for value in each]
    return Experiment("fox", "gs_hider", "0", tuple(rows), {})


def test_a_control_is_as_unsure_as_what_it_is_a_control_for() -> None:
    """The control's area is below the interval of what hides, but other views might well reverse the order."""
    first, second, clean = np.random.default_rng(0).normal(0, 1, (3, VIEWS))
    unsure = [scored(first + 0.8, second + 0.4, 0.3 * clean)]
    hiding, chance = (area_of(unsure, LOGIT, each) for each in (HIDING, CHANCE))
    assert 0.5 < chance.value < hiding.low
    assert excess_of(unsure, LOGIT).low < 0 < excess_of(unsure, LOGIT).value
    assert verdict(unsure, LOGIT) == "distinguished, but not significantly better than two that hide nothing"


def test_what_both_share_is_drawn_once() -> None:
    """Cameras change both alike, and at each camera the containers that hide score higher."""
    views, clean = np.random.default_rng(0).normal(0, 1, (2, VIEWS))
    sure = [scored(views + 0.8, views + 0.5, clean)]
    hiding, chance, excess = area_of(sure, LOGIT, HIDING), area_of(sure, LOGIT, CHANCE), excess_of(sure, LOGIT)
    assert hiding.low < chance.value
    assert excess.value == pytest.approx(hiding.value - chance.value)
    assert excess.low > 0
    assert verdict(sure, LOGIT) == "distinguished"
    assert excess_cell(sure, LOGIT).text == f"{excess.value:+.2f}"
    assert excess_cell([seen("fox", 0.95, None)], LOGIT).text == ""


def test_renders_are_of_the_same_cameras_and_photos_are_not() -> None:
    """Other numbers of renders are of other cameras, and cannot be compared with their control view by view."""

    def counted(hidden: int, photos: int, clean: int) -> Experiment:
        counts = {HIDDEN: hidden, PHOTOS: photos, CLEAN: clean, CLEAN_AGAIN: VIEWS}
        rows = [Measurement(LOGIT, view / 7 % 1, kind) for kind, count in counts.items() for view in range(count)]
        return Experiment("fox", "gs_hider", "0", tuple(rows), {})

    alike, fewer = counted(VIEWS, VIEWS, VIEWS), counted(VIEWS - 1, VIEWS, VIEWS)
    kinds = (AS_IN_THE_PAPER, RENDERING, HIDING, CHANCE)
    assert [scores_of([alike], LOGIT, kind)[0].paired for kind in kinds] == [False, False, True, True]
    assert [scores_of([fewer], LOGIT, kind)[0].paired for kind in kinds] == [False, False, False, True]
    assert not math.isnan(excess_of([alike], LOGIT).value)
    assert math.isnan(excess_of([fewer], LOGIT).value)


def test_what_has_no_scores_has_no_part_in_the_excess() -> None:
    measured, other = seen("fox", 0.95, 0.5), seen("bonsai", 0.95, 0.5)
    unmeasured = tuple(replace(row, value=math.nan) if row.condition == HIDDEN else row for row in other.rows)
    assert excess_of([measured, replace(other, rows=unmeasured)], LOGIT) == excess_of([measured], LOGIT)


@pytest.mark.parametrize(("hiding", "words"), [(0.57, "barely distinguished"), (0.65, "distinguished")])
def test_what_ranks_more_than_six_of_ten_pairs_is_not_called_barely(hiding: float, words: str) -> None:
    captures = [seen(f"capture {number}", hiding, 0.5) for number in range(12)]
    assert verdict(captures, LOGIT).startswith(words)


def test_chance_that_was_not_measured_is_said() -> None:
    unknown = [seen("fox", 0.95, None)]
    assert math.isnan(area_of(unknown, LOGIT, CHANCE).value)
    assert verdict(unknown, LOGIT) == "distinguished, but the level of chance was not measured"
    assert verdict([], LOGIT) == "not measured"
    assert verdict([seen("fox", 0.5, 0.5)], LOGIT) == "not distinguished"


def test_what_is_told_on_some_captures_alone_is_said() -> None:
    """In either direction; a capture counts if its area is farther from chance than that of two that hide nothing."""
    both_ways = [seen("fox", 0.95, 0.5), seen("bonsai", 0.05, 0.5), seen("kitchen", 0.5, 0.5)]
    assert verdict(both_ways, LOGIT) == "distinguished only on 2 of 3 captures, in opposite directions"
    assert verdict(both_ways[:2], LOGIT) == "distinguished, in opposite directions"
    mostly = [seen("fox", 0.95, 0.5), seen("bonsai", 0.95, 0.5), seen("kitchen", 0.6, 0.52)]
    assert verdict(mostly, LOGIT) == "distinguished (individually on 2 of 3 captures)"
    one = [seen("fox", 0.75, 0.9), seen("bonsai", 0.2, 0.5)]
    assert verdict(one, LOGIT) == "distinguished only on 1 of 2 captures"


@pytest.mark.parametrize("quantity", [FUSION, LOGIT])
def test_directions_do_not_cancel_and_controls_are_averaged_as_what_they_are_controls_for(quantity: str) -> None:
    """In the table, the relation and the words alike, 0.65 and 0.22 count as 0.65 and 0.78.

    Likewise, controls of 0.69 and 0.45 count as 0.69 and 0.55, and do not average to chance.
    """
    logits = [seen("fox", 0.65, 0.69), seen("bonsai", 0.22, 0.45)]
    quantities = (FUSION, *DETECTORS) if quantity == FUSION else (LOGIT,)
    given = []
    for each in logits:
        rows = [replace(row, quantity=name) for row in each.rows for name in quantities]
        more = [] if quantity == FUSION else [Measurement(TRAINING_SCENES, 1, HIDDEN)]
        given.append(replace(each, rows=(*rows, *more)))
    chapter = steganalysis(Study((), experiments=tuple(given)), read_published())
    [relation] = chapter.relations
    assert relation.value == pytest.approx((0.65 + 0.78) / 2, abs=0.01)
    [grid] = [grid for grid in chapter.grids if "All captures" in grid.headings]
    assert AREA_NOTE in grid.notes
    lines = {line.names[-1]: line.cells[-1] for line in grid.lines}
    assert lines[HIDING.title].spread.mean == relation.value
    assert lines[HIDING.title].note.endswith("↓ on 1 of 2")
    assert lines[CHANCE.title].spread.mean == pytest.approx((0.69 + 0.55) / 2, abs=0.01)
    assert lines[EXCESS].spread.mean == pytest.approx((0.65 + 0.78 - 0.69 - 0.55) / 2, abs=0.01)
    told = "distinguished only on 1 of 2 captures"
    assert told in [cell.text for cell in chapter.grids[0].lines[0].cells]
    assert quantity != FUSION or any(f"with and without a message: {told}." in note for note in grid.notes)
    assert relation.verdict.startswith("does not hold")


def test_the_papers_finding_on_stegexpose_can_fail() -> None:
    """That GS-Hider's renders are told from photos less than those of the others of its methods."""

    def against_photos(method: str, capture: str, share: float) -> Experiment:
        values = {PHOTOS: np.linspace(0, 1, VIEWS), HIDDEN: _above(share)}
        rows = [
            Measurement(name, float(v), c) for c, all_ in values.items() for v in all_ for name in (FUSION, *DETECTORS)
        ]
        return Experiment(capture, method, "0", tuple(rows), {})

    shares = {"gs_hider": (0.7, 0.7), "sh": (0.95, 0.1), "decoder": (0.6, 0.45), "homogeneous": (1.0, 1.0)}
    given = [
        against_photos(method, capture, share)
        for method, each in shares.items()
        for capture, share in zip(("fox", "bonsai"), each, strict=True)
    ]
    found = {each.text: each for each in steganalysis(Study((), experiments=tuple(given)), read_published()).relations}
    [of_sh] = [each for text, each in found.items() if "3DGS+SH's over that of GS-Hider" in text]
    [of_decoder] = [each for text, each in found.items() if "3DGS+Decoder's over that of GS-Hider" in text]
    assert of_sh.value == pytest.approx((0.95 / 0.7 + 0.9 / 0.7) / 2, abs=0.02)
    assert of_sh.verdict == "holds"
    assert of_decoder.value < 1
    assert of_decoder.verdict.startswith("does not hold")
    assert not [text for text in found if "Homogeneous" in text], "the paper says nothing of it"


def test_two_trainings_of_a_scene_are_not_pooled() -> None:
    """Each is distinguished from its clean twin; how the trainings differ from each other does not matter."""
    rows = []
    for training, offset in enumerate((0.0, 10.0)):
        rows += [Measurement(LOGIT, offset + view / VIEWS, CLEAN, seed=training) for view in range(VIEWS)]
        rows += [Measurement(LOGIT, offset + 2 + view / VIEWS, HIDDEN, seed=training) for view in range(VIEWS)]
    area = area_of([Experiment("fox", "gs_hider", "0", tuple(rows), {})], LOGIT, HIDING)
    assert (area.value, area.low, area.high) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("views", "said"), [(2, "not known: too few views"), (VIEWS, "distinguished")])
def test_a_few_views_say_nothing(views: int, said: str) -> None:
    """Of two views that are ranked rightly, resampled ones always are, too."""
    few = seen("fox", 1.0, 0.5)
    kept = [
        row for kind in (HIDDEN, CLEAN, CLEAN_AGAIN) for row in [r for r in few.rows if r.condition == kind][:views]
    ]
    rows = [replace(row, quantity=name) for row in kept for name in (FUSION, *DETECTORS)]
    experiments = [replace(few, rows=tuple(rows))]
    assert verdict(experiments, FUSION) == said
    cells = [area_cell(experiments, FUSION, HIDING), excess_cell(experiments, FUSION)]
    assert [("too few views for an interval" in cell.note) for cell in cells] == [views == 2] * 2
    assert cells[0].text == "1.00"
    assert bool(steganalysis(Study((), experiments=tuple(experiments)), read_published()).relations) is (views > 2)
