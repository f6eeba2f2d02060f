"""What detectors find: StegExpose as in the paper and beside clean renders, a learned detector, the attributes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from stages.analysis.attribute_histograms import GAUSSIANS, ONLY_THERE
from stages.analysis.learned_detection import LEARNED, TRAINING_SCENES
from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.page.material import METHOD_TITLES
from stages.analysis.paper.attribute_tables import attribute_charts, attributes_grid
from stages.analysis.paper.chapter import Chapter, title_of
from stages.analysis.paper.detection import (
    AS_IN_THE_PAPER,
    CHANCE,
    COMPARISONS,
    HIDING,
    RENDERING,
    UNNOTICED,
    Comparison,
    area_cell,
    area_of,
    scores_of,
    verdict,
)
from stages.analysis.paper.grid import Cell, Grid, Line
from stages.analysis.paper.measuring import Measured, Spread
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Experiment, Study, capture_title
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS
from stages.analysis.roc import roc_curve
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION

DEVIATIONS = 2 * 1.96
"""How many standard deviations wide a 95 % interval is."""

DETECTOR_TITLES = {
    "primary_sets": "primary sets",
    "chi_square": "chi-square",
    "sample_pairs": "sample pairs",
    "rs_analysis": "RS analysis",
    FUSION: "fusion",
}
CLASS_TITLES = {
    PHOTOS: "photos",
    HIDDEN: "renders that hide",
    CLEAN: "renders that hide nothing",
    CLEAN_AGAIN: "the same, other seed",
}
MOST_POINTS = 120
"""Of a curve in a chart: more cannot be seen."""

ByMethod = dict[str, list[Experiment]]


def steganalysis(study: Study, tables: Published) -> Chapter:
    """From the rows of `steganalysis`, `detect_hidden` and `compare_attributes`."""
    by_stegexpose = _by_method(study, FUSION)
    by_learning = _by_method(study, TRAINING_SCENES)
    by_attributes = _by_method(study, GAUSSIANS)
    captures = study.captures
    grids = [
        *([_summary_grid(by_stegexpose, by_learning, by_attributes)] if study.experiments else []),
        *([_areas_grid(by_stegexpose, captures), _detectors_grid(by_stegexpose)] if by_stegexpose else []),
        *([_learned_grid(by_learning, captures)] if by_learning else []),
        *([_counts_grid(by_stegexpose, captures)] if by_stegexpose else []),
        *([attributes_grid(by_attributes, captures)] if by_attributes else []),
    ]
    return Chapter(
        "Can it be detected?",
        tuple(grids),
        (
            *_relations(by_stegexpose, FUSION, "StegExpose"),
            *(
                relation
                for quantity, seen in LEARNED.items()
                for relation in _relations(by_learning, quantity, f"a learned detector on {seen}")
            ),
        ),
        charts=(*_curves(by_stegexpose, captures), *attribute_charts(by_attributes)),
    )


def _by_method(study: Study, quantity: str) -> ByMethod:
    """The experiments that measured a quantity, in the paper's order of methods."""
    found: ByMethod = {}
    for experiment in study.experiments:
        if any(row.quantity == quantity for row in experiment.rows):
            found.setdefault(experiment.method, []).append(experiment)
    order = [*METHOD_TITLES, *sorted(found.keys() - METHOD_TITLES.keys())]
    return {method: found[method] for method in order if method in found}


def _summary_grid(by_stegexpose: ByMethod, by_learning: ByMethod, by_attributes: ByMethod) -> Grid:
    """What is not secure, in words."""

    def told(by_method: ByMethod, method: str, quantity: str) -> Cell:
        areas = (area_of(by_method.get(method, []), quantity, each).two_sided for each in (HIDING, CHANCE))
        return Cell(verdict(*areas))

    def file(method: str) -> Cell:
        rows = [row for each in by_attributes.get(method, []) for row in each.rows if row.quantity == ONLY_THERE]
        own = {row.value for row in rows if row.condition == HIDDEN}
        if not own:
            return Cell("not measured")
        return Cell(f"{max(own):.0f} attributes that no clean one has" if max(own) else "no attribute of its own")

    methods = dict.fromkeys((*by_stegexpose, *by_learning, *by_attributes))
    return Grid(
        "Is what hides told from what does not?",
        ("Method",),
        ("StegExpose", *(f"A learned detector, on {seen}" for seen in LEARNED.values()), "The published file"),
        tuple(
            Line(
                (title_of(method),),
                (
                    told(by_stegexpose, method, FUSION),
                    *(told(by_learning, method, quantity) for quantity in LEARNED),
                    file(method),
                ),
            )
            for method in methods
        ),
        (
            "All captures together. Not told apart: the 95 % interval reaches down to chance. Told apart, but so are "
            "two that hide nothing: no farther than two clean trainings are from each other. What no detector here "
            "finds may be found by others.",
        ),
    )


def _areas_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    return Grid(
        "StegExpose's fusion: area under the ROC curve, two-sided",
        ("Method", "Told apart"),
        (*map(capture_title, captures), "All together"),
        tuple(
            Line((title_of(method), comparison.title), _cells(experiments, FUSION, comparison, captures))
            for method, experiments in by_method.items()
            for comparison in COMPARISONS
        ),
        (
            "0.5: no better than chance; 1: always right. In small letters the 95 % interval, by drawing runs of "
            "neighbouring views (and scenes, under All together: of as few as here that says little). ↓: the detector "
            "gives the first class less; its opposite is scored, which anyone would use.",
            *(_finding(method, experiments) for method, experiments in by_method.items()),
            "The GS-Hider paper compares renders with photos only, and prints a figure without values. KeySS (ICLR "
            "2026) reports 0.45 of itself in the same way, two-sided 0.55.",
        ),
    )


def _finding(method: str, experiments: Sequence[Experiment]) -> str:
    """What a method's areas say in words."""
    photos, rendering, hiding, chance = (
        area_of(experiments, FUSION, comparison).two_sided for comparison in COMPARISONS
    )
    seen = "mostly that they are renders" if rendering.value > photos.value - 0.05 else "more than rendering"
    return (
        f"{title_of(method)}: renders are told from photos by {photos.value:.2f}, and by {rendering.value:.2f} where "
        f"nothing is hidden: what is seen is {seen}. Renders with and without a message: {verdict(hiding, chance)}."
    )


def _cells(
    experiments: Sequence[Experiment], quantity: str, comparison: Comparison, captures: Sequence[str]
) -> tuple[Cell, ...]:
    """On each capture, and on all together."""
    own = [[each for each in experiments if each.capture == capture] for capture in captures]
    return tuple(area_cell(group, quantity, comparison) for group in (*own, experiments))


def _detectors_grid(by_method: ByMethod) -> Grid:
    shown = (AS_IN_THE_PAPER, HIDING, CHANCE)
    return Grid(
        "StegExpose's detectors by themselves, all captures together: area under the ROC curve, two-sided",
        ("Method", "Detector"),
        (*(comparison.title for comparison in shown), "Pictures without a value"),
        tuple(
            Line(
                (title_of(method), DETECTOR_TITLES[detector]),
                (*(area_cell(experiments, detector, each) for each in shown), _missing(experiments, detector)),
            )
            for method, experiments in by_method.items()
            for detector in DETECTORS
        ),
    )


def _missing(experiments: Sequence[Experiment], detector: str) -> Cell:
    values = [row.value for each in experiments for row in each.rows if row.quantity == detector]
    share = sum(map(math.isnan, values)) / len(values)
    return Cell(f"{100 * share:.0f} %", "", Spread(share))


def _learned_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    rows = [row for experiments in by_method.values() for each in experiments for row in each.rows]
    counts = sorted({int(row.value) for row in rows if row.quantity == TRAINING_SCENES and row.value > 0})
    return Grid(
        "A network on noise residuals, trained on the other scenes: area under the ROC curve, two-sided",
        ("Method", "Looks at", "Told apart"),
        (*map(capture_title, captures), "All together"),
        tuple(
            Line((title_of(method), seen, comparison.title), _cells(experiments, quantity, comparison, captures))
            for method, experiments in by_method.items()
            for quantity, seen in LEARNED.items()
            for comparison in (HIDING, CHANCE)
            if scores_of(experiments, quantity, comparison)
        ),
        (
            f"Each detector knows the method, and learnt from {' or '.join(map(str, counts))} other scene(s), of each "
            "of which it saw one container and one clean training: it may have learnt what sets these few apart, and "
            "one that saw hundreds would do better. An area near 0.5 is no proof of security; one that is far from it, "
            "and farther than that of two clean trainings, is proof of the opposite."
            if counts
            else "Not measured: it takes renders of two captures at least, one to learn from and one to be tested on.",
        ),
    )


def _counts_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    def most(condition: str, capture: str) -> int:
        counts = [
            sum((row.quantity, row.condition) == (FUSION, condition) for row in each.rows)
            for experiments in by_method.values()
            for each in experiments
            if each.capture == capture
        ]
        return max(counts, default=0)

    stages = dict.fromkeys(each.stage for experiments in by_method.values() for each in experiments)
    return Grid(
        "Pictures of each class",
        ("Class",),
        tuple(map(capture_title, captures)),
        tuple(
            Line((title,), tuple(Cell(str(most(condition, capture))) for capture in captures))
            for condition, title in CLASS_TITLES.items()
        ),
        (
            "Renders are from new cameras along the rig, photos all that were registered, undistorted and at the size "
            "of the renders. Whatever their numbers, both classes and all scenes weigh alike: the paper mixes in equal "
            "proportions.",
            f"What every detector says of every picture: the measurements of {', '.join(stages)}.",
        ),
    )


def _relations(by_method: ByMethod, quantity: str, detector: str) -> Iterator[Relation]:
    for method, experiments in by_method.items():
        areas = {}
        for capture in dict.fromkeys(each.capture for each in experiments):
            area = area_of([each for each in experiments if each.capture == capture], quantity, HIDING).two_sided
            if not math.isnan(area.value):
                areas[capture] = area
        if areas:
            yield Relation(
                f"{title_of(method)}: area by which {detector} tells what hides from what does not",
                "ratio",
                "at most",
                UNNOTICED,
                Measured({capture: Spread(area.value) for capture, area in areas.items()}),
                noise=math.hypot(*((area.high - area.low) / DEVIATIONS for area in areas.values())) / len(areas),
            )


def _curves(by_method: ByMethod, captures: Sequence[str]) -> Iterator[Chart]:
    """As in the paper's figure, and against clean renders: by capture, and of several captures together."""
    groups: Mapping[str, Sequence[str]] = {capture_title(capture): [capture] for capture in captures}
    if len(captures) > 1:
        groups = {"All together": captures, **groups}
    for comparison in COMPARISONS:
        controls_once = list(groups.items())[:1] if comparison in (RENDERING, CHANCE) else groups.items()
        for title, among in controls_once:
            series = [
                Series(
                    title_of(method),
                    _thinned(roc_curve(scores_of([e for e in experiments if e.capture in among], FUSION, comparison))),
                )
                for method, experiments in by_method.items()
            ]
            if any(each.points for each in series):
                chart = line_chart(
                    f"{title}: {comparison.title}",
                    [*series, Series("chance", ((0.0, 0.0), (1.0, 1.0)))],
                    from_zero=False,
                    axes=("false positive rate", "true positive rate"),
                )
                if chart is not None:
                    yield chart


def _thinned(curve: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    step = max(1, math.ceil(len(curve) / MOST_POINTS))
    return (*curve[:-1:step], *curve[-1:])
