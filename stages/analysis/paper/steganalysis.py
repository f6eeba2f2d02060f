"""What detectors find: StegExpose as in the paper and against clean renders, a learned detector, and attributes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from stages.analysis.attribute_histograms import GAUSSIANS
from stages.analysis.learned_detection import LEARNED, TRAINING_SCENES
from stages.analysis.method_titles import DECODER, GS_HIDER, SECOND_HARMONICS
from stages.analysis.paper.attribute_tables import attribute_charts, attributes_grid
from stages.analysis.paper.chapter import Chapter, title_of
from stages.analysis.paper.detection import (
    AS_IN_THE_PAPER,
    HIDING,
    UNNOTICED,
    ByMethod,
    Comparison,
    area_of,
    by_capture,
)
from stages.analysis.paper.measuring import Measured, Noise, Spread
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import OnEachCapture, Relation
from stages.analysis.paper.roc_charts import roc_charts
from stages.analysis.paper.runs import Experiment, Study, by_method
from stages.analysis.paper.steganalysis_tables import (
    areas_grid,
    counts_grid,
    detectors_grid,
    learned_grid,
    summary_grid,
)
from stages.analysis.roc import Area
from stages.analysis.stegexpose.fusion import FUSION

DEVIATIONS = 2 * 1.96
"""Width of a 95 % interval, in standard deviations."""


def steganalysis(study: Study, tables: Published) -> Chapter:
    """The chapter on the rows of `steganalysis`, `detect_hidden` and `compare_attributes`."""
    by_stegexpose = _by_method(study, FUSION)
    by_learning = _by_method(study, TRAINING_SCENES)
    by_attributes = _by_method(study, GAUSSIANS)
    captures = study.captures
    grids = [
        *([summary_grid(by_stegexpose, by_learning, by_attributes)] if study.experiments else []),
        *([areas_grid(by_stegexpose, captures), detectors_grid(by_stegexpose)] if by_stegexpose else []),
        *([learned_grid(by_learning, captures)] if by_learning else []),
        *([counts_grid(by_stegexpose, captures)] if by_stegexpose else []),
        *([attributes_grid(by_attributes, captures)] if by_attributes else []),
    ]
    return Chapter(
        "Can it be detected?",
        tuple(grids),
        (
            *_of_the_paper(by_stegexpose),
            *_relations(by_stegexpose, FUSION, "StegExpose"),
            *(
                relation
                for quantity, seen in LEARNED.items()
                for relation in _relations(by_learning, quantity, f"a learned detector on {seen}")
            ),
        ),
        charts=(*roc_charts(by_stegexpose, captures), *attribute_charts(by_attributes)),
    )


def _by_method(study: Study, quantity: str) -> ByMethod:
    """The experiments that measured a quantity, by method."""
    return by_method(each for each in study.experiments if any(row.quantity == quantity for row in each.rows))


def _relations(experiments_of: ByMethod, quantity: str, detector: str) -> Iterator[Relation]:
    for method, experiments in experiments_of.items():
        areas = _areas(experiments, quantity, HIDING)
        if areas:
            yield OnEachCapture(
                f"{title_of(method)}: two-sided area of {detector}, renders that hide against renders that do not",
                "ratio",
                "at most",
                UNNOTICED,
                Measured({capture: Spread(area.value) for capture, area in areas.items()}),
                noise=_of_one([(area.high - area.low) / DEVIATIONS for area in areas.values()]),
            )


def _of_the_paper(experiments_of: ByMethod) -> Iterator[Relation]:
    """The paper's finding: of its methods, StegExpose tells GS-Hider's renders from photos the least."""
    own = _areas(experiments_of.get(GS_HIDER, ()), FUSION, AS_IN_THE_PAPER)
    for method in (SECOND_HARMONICS, DECODER):
        areas = _areas(experiments_of.get(method, ()), FUSION, AS_IN_THE_PAPER)
        both = {capture: (area, own[capture]) for capture, area in areas.items() if capture in own}
        if both:
            yield Relation(
                f"StegExpose's two-sided area, renders that hide against photos: {title_of(method)}'s over that of "
                f"{title_of(GS_HIDER)}",
                "ratio",
                "more than",
                1.0,
                Measured({capture: Spread(rival.value / least.value) for capture, (rival, least) in both.items()}),
                noise=_of_one([_deviation_of_ratio(rival, least) for rival, least in both.values()]),
                source="shown",
            )


def _areas(experiments: Sequence[Experiment], quantity: str, comparison: Comparison) -> dict[str, Area]:
    """The two-sided area on each capture where it has an interval: too few views say nothing."""
    areas = {own[0].capture: area_of(own, quantity, comparison) for own in by_capture(experiments)}
    return {capture: area for capture, area in areas.items() if not math.isnan(area.low)}


def _deviation_of_ratio(rival: Area, least: Area) -> float:
    """The standard deviation of the ratio of two areas."""
    parts = ((area.high - area.low) / DEVIATIONS / area.value for area in (rival, least))
    return rival.value / least.value * math.hypot(*parts)


def _of_one(deviations: Sequence[float]) -> Noise:
    """The root mean square of the deviations: if each had this value, that of the average would be the same."""
    return Noise(math.hypot(*deviations) / math.sqrt(len(deviations)), math.inf)
