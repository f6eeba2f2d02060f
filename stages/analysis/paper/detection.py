"""Areas under ROC curves from rows of detectors: which classes are compared, and how areas are written."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.analysis.paper.grid import Cell
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.runs import Experiment
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS
from stages.analysis.roc import RUNS, Area, DetectorScores, bootstrap_area, bootstrap_excess, is_upside_down, two_sided

UNNOTICED = 0.6
"""A detector with a larger area ranks more than six of ten pairs correctly, and is not called blind."""


ByMethod = Mapping[str, Sequence[Experiment]]
"""Experiments by the hiding method, as `runs.by_method` groups them."""


@dataclass(frozen=True)
class Comparison:
    """Two classes of pictures; `paired` if both are seen from the same cameras."""

    title: str
    positive: str
    negative: str
    paired: bool = True


AS_IN_THE_PAPER = Comparison("renders that hide, against photos", HIDDEN, PHOTOS, paired=False)
RENDERING = Comparison("renders that hide nothing, against photos", CLEAN, PHOTOS, paired=False)
HIDING = Comparison("renders that hide, against renders that do not", HIDDEN, CLEAN)
CHANCE = Comparison("two that hide nothing, against each other", CLEAN_AGAIN, CLEAN)
COMPARISONS = (AS_IN_THE_PAPER, RENDERING, HIDING, CHANCE)


def scores_of(experiments: Iterable[Experiment], quantity: str, comparison: Comparison) -> tuple[DetectorScores, ...]:
    """A detector's scores of both classes, for each experiment that has both; each capture is a scene.

    Several trainings of one scene, whose rows differ in their seed, give separate scores.
    """
    return tuple(_scores_by_training(experiments, quantity, comparison).values())


def _scores_by_training(
    experiments: Iterable[Experiment], quantity: str, comparison: Comparison
) -> dict[tuple[int, int | None], DetectorScores]:
    """Scores by the position of the experiment and the seed of its rows."""
    found = {}
    for number, experiment in enumerate(experiments):
        rows = [row for row in experiment.rows if row.quantity == quantity]
        for seed in dict.fromkeys(row.seed for row in rows):
            positives, negatives = (
                np.array([row.value for row in rows if (row.seed, row.condition) == (seed, condition)])
                for condition in (comparison.positive, comparison.negative)
            )
            if len(positives) and len(negatives):
                is_paired = comparison.paired and len(positives) == len(negatives)
                found[number, seed] = DetectorScores(positives, negatives, is_paired, experiment.capture)
    return found


def area_of(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> Area:
    """The mean over captures of the two-sided areas, with its interval; NaN without any.

    The two-sided area of a capture is that of the detector or of its inverse, whichever is larger there: an area of
    0.22 reveals as much as one of 0.78, and of two trainings that hide nothing, neither comes first. This applies to
    all detectors and comparisons. Chance alone raises such areas a little, so compare an area with that of two
    trainings that hide nothing. The seed of the interval follows from the quantity and the comparison. The interval is
    NaN if a class has fewer than `roc.RUNS` views: of one or two, all resampled ones are alike.
    """
    seed = zlib.crc32(f"{quantity}: {comparison.title}".encode())
    scores = two_sided(scores_of(experiments, quantity, comparison))
    return _as_certain_as(scores, bootstrap_area(scores, seed))


def excess_of(experiments: Sequence[Experiment], quantity: str) -> Area:
    """How much the area for containers that hide exceeds that for two clean ones; NaN if no experiment has both.

    Both share the clean renders, and all three classes the cameras, so the same views of all three are resampled. The
    interval is that of `area_of`.
    """
    hiding, chance = (_scores_by_training(experiments, quantity, each) for each in (HIDING, CHANCE))
    both = [(own, chance[key]) for key, own in hiding.items() if key in chance]
    pairs = [pair for pair in both if all(each.usable and each.paired for each in pair)]
    own, controls = (two_sided(each) for each in zip(*pairs, strict=True)) if pairs else ([], [])
    return _as_certain_as(own, bootstrap_excess(own, controls, zlib.crc32(f"{quantity}: above chance".encode())))


def _as_certain_as(scores: Iterable[DetectorScores], area: Area) -> Area:
    """The area, without an interval if a class has too few views for one."""
    fewest = min((len(views) for each in scores for views in (each.positives, each.negatives)), default=RUNS)
    return area if fewest >= RUNS else replace(area, low=math.nan, high=math.nan)


def _interval(area: Area, form: str) -> str:
    """The bounds of an area, each written in this form."""
    return "too few views for an interval" if math.isnan(area.low) else f"{area.low:{form}} to {area.high:{form}}"


def is_inverted(capture: Sequence[Experiment], quantity: str, comparison: Comparison) -> bool:
    """Whether a capture's two-sided area is that of the detector's inverse."""
    return is_upside_down(scores_of(capture, quantity, comparison))


def by_capture(experiments: Iterable[Experiment]) -> list[list[Experiment]]:
    """The experiments, grouped by capture."""
    found: dict[str, list[Experiment]] = {}
    for each in experiments:
        found.setdefault(each.capture, []).append(each)
    return [*found.values()]


def area_cell(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> Cell:
    """The area with its interval; an arrow marks that of the inverse detector, and on how many captures it is.

    Empty if no area was measured.
    """
    shown = area_of(experiments, quantity, comparison)
    if math.isnan(shown.value):
        return Cell("")
    note = _interval(shown, ".2f") + _arrow(experiments, quantity, comparison)
    return Cell(f"{shown.value:.2f}", note, Spread(shown.value))


def excess_cell(experiments: Sequence[Experiment], quantity: str) -> Cell:
    """`excess_of` with its interval; empty if it was not measured."""
    excess = excess_of(experiments, quantity)
    if math.isnan(excess.value):
        return Cell("")
    return Cell(f"{excess.value:+.2f}", _interval(excess, "+.2f"), Spread(excess.value))


def _arrow(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> str:
    captures = [own for own in by_capture(experiments) if scores_of(own, quantity, comparison)]
    inverted = sum(is_inverted(own, quantity, comparison) for own in captures)
    if inverted in (0, len(captures)):
        return " ↓" if inverted else ""
    return f" ↓ on {inverted} of {len(captures)}"


def verdict(experiments: Sequence[Experiment], quantity: str) -> str:
    """In words, whether a detector distinguishes containers that hide from clean ones, compared with two clean ones.

    The verdict is on all captures together, and says on how many it holds by itself if these are some, but not all.
    """
    hiding, excess = area_of(experiments, quantity, HIDING), excess_of(experiments, quantity)
    if math.isnan(hiding.value):
        return "not measured"
    if math.isnan(hiding.low):
        return "not known: too few views"
    captures = [own for own in by_capture(experiments) if scores_of(own, quantity, HIDING)]
    told = [own for own in captures if _is_told_apart(own, quantity)]
    some = f"on {len(told)} of {len(captures)} captures" if 0 < len(told) < len(captures) else ""
    if hiding.low > 0.5 and not excess.low <= 0:
        words = "distinguished" if hiding.value > UNNOTICED else "barely distinguished"
        words += f" (individually {some})" if some else ""
    elif some:
        words = f"distinguished only {some}"
    elif hiding.low > 0.5:
        return "distinguished, but not significantly better than two that hide nothing"
    else:
        return "not distinguished"
    ways = {is_inverted(own, quantity, HIDING) for own in told}
    words += ", in opposite directions" if len(ways) > 1 else ""
    return words + (", but the level of chance was not measured" if math.isnan(excess.value) else "")


def _is_told_apart(capture: Sequence[Experiment], quantity: str) -> bool:
    """Whether the detector distinguishes the classes on this capture alone, and better than two clean ones."""
    area = area_of(capture, quantity, HIDING)
    return area.value > UNNOTICED and area.low > 0.5 and not excess_of(capture, quantity).low <= 0
