"""Areas under ROC curves from rows of detectors: which classes are compared, and how an area is written."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stages.analysis.learned_detection import LEARNED
from stages.analysis.paper.grid import Cell
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.runs import Experiment
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS
from stages.analysis.roc import Area, DetectorScores, bootstrap_area

UNNOTICED = 0.6
"""A detector whose area is larger is right about more than six of ten pairs, and is not called blind."""


ByMethod = Mapping[str, Sequence[Experiment]]
"""Experiments by the method that hides, as `runs.by_method` groups them."""


@dataclass(frozen=True)
class Comparison:
    """Two classes of pictures; `paired`: seen from the same cameras."""

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
    """What one kind of detector says of both classes, for each experiment that has them; a capture is a scene.

    Rows of several trainings of one scene, told apart by their seed, are scores of their own.
    """
    found = []
    for experiment in experiments:
        rows = [row for row in experiment.rows if row.quantity == quantity]
        for seed in dict.fromkeys(row.seed for row in rows):
            positives, negatives = (
                np.array([row.value for row in rows if (row.seed, row.condition) == (seed, condition)])
                for condition in (comparison.positive, comparison.negative)
            )
            if len(positives) and len(negatives):
                is_paired = comparison.paired and len(positives) == len(negatives)
                found.append(DetectorScores(positives, negatives, is_paired, experiment.capture))
    return tuple(found)


def area_of(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> Area:
    """The mean of the scenes' areas, NaN without any.

    Two-sided: whoever knows that StegExpose gives renders less than photos inverts it. Not so of a learned detector,
    which has learnt which side is which: if it takes the wrong one it has learnt nothing of this scene.
    """
    area = _directed_area(experiments, quantity, comparison)
    return area if quantity in LEARNED else area.two_sided


def _directed_area(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> Area:
    """The seed of its interval follows from what it is of."""
    seed = zlib.crc32(f"{quantity}: {comparison.title}".encode())
    return bootstrap_area(scores_of(experiments, quantity, comparison), seed)


def is_inverted(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> bool:
    """Whether the area is that of the detector's opposite."""
    return area_of(experiments, quantity, comparison) != _directed_area(experiments, quantity, comparison)


def area_cell(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> Cell:
    """The area with its interval, and an arrow where it is that of the opposite; empty where none was measured."""
    shown = area_of(experiments, quantity, comparison)
    if math.isnan(shown.value):
        return Cell("")
    note = f"{shown.low:.2f} to {shown.high:.2f}" + (" ↓" if is_inverted(experiments, quantity, comparison) else "")
    return Cell(f"{shown.value:.2f}", note, Spread(shown.value))


def verdict(experiments: Sequence[Experiment], quantity: str) -> str:
    """In words, whether a detector tells what hides from what does not, beside two trainings that hide nothing."""
    hiding, chance = area_of(experiments, quantity, HIDING), area_by_chance(experiments, quantity)
    if math.isnan(hiding.value):
        return "not measured"
    if hiding.low <= 0.5:
        return _captures_told_apart(experiments, quantity)
    if hiding.low <= chance:
        return "told apart, but so are two that hide nothing"
    told = "told apart" if hiding.value > UNNOTICED else "hardly told apart"
    return told + (", how far chance does it was not measured" if math.isnan(chance) else "")


def _captures_told_apart(experiments: Sequence[Experiment], quantity: str) -> str:
    """Of what is not told apart on all captures together: on how many by itself, farther than two that hide nothing."""
    captures = _by_capture(experiments)
    told = [own for own in captures if _is_told_apart(own, quantity)]
    if not told or len(captures) < 2:
        return "not told apart"
    ways = {is_inverted(own, quantity, HIDING) for own in told}
    return f"told apart on {len(told)} of {len(captures)} captures" + (", in opposite directions" * (len(ways) > 1))


def _is_told_apart(capture: Sequence[Experiment], quantity: str) -> bool:
    area, chance = area_of(capture, quantity, HIDING), area_by_chance(capture, quantity)
    return area.value > UNNOTICED and area.low > (0.5 if math.isnan(chance) else max(0.5, chance))


def _by_capture(experiments: Sequence[Experiment]) -> list[list[Experiment]]:
    captures = dict.fromkeys(each.capture for each in experiments)
    return [[each for each in experiments if each.capture == capture] for capture in captures]


def area_by_chance(experiments: Sequence[Experiment], quantity: str) -> float:
    """How far apart two trainings lie that hide nothing: the mean of the captures' two-sided areas, NaN without any.

    Which of the two comes first means nothing, so that a capture where the area is 0.28 is as far from chance as one
    with 0.72, and the mean of both is no chance.
    """
    areas = [area_of(own, quantity, CHANCE).two_sided.value for own in _by_capture(experiments)]
    measured = [area for area in areas if not math.isnan(area)]
    return sum(measured) / len(measured) if measured else math.nan
