"""Tables of what detectors find: in words, by method and capture, by detector, and the numbers of pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from stages.analysis.attribute_histograms import ONLY_THERE
from stages.analysis.learned_detection import LEARNED, TRAINING_PAIRS, TRAINING_SCENES
from stages.analysis.measurements import Measurement
from stages.analysis.paper.attribute_tables import widest_divergence
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.detection import (
    AS_IN_THE_PAPER,
    CHANCE,
    COMPARISONS,
    HIDING,
    RENDERING,
    UNNOTICED,
    ByMethod,
    Comparison,
    area_cell,
    area_of,
    by_capture,
    excess_cell,
    is_inverted,
    scores_of,
    verdict,
)
from stages.analysis.paper.grid import Cell, Grid, Line
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.runs import Experiment, capture_title
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION

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


EXCESS = "the first of these two minus the second"
"""Title of the line below renders that hide and two that hide nothing."""

AREA_NOTE = (
    "0.5: no better than chance; 1: always right. ↓: the detector scores the first class lower, so its inverse is "
    "used, on each capture separately. All captures: the mean of the captures' areas as shown, also for two that hide "
    "nothing, neither of which comes first. Chance raises such areas a little above 0.5: compare each with that of two "
    "that hide nothing. Second figures: the 95 % interval from a bootstrap over runs of neighbouring views (and, under "
    "All captures, over captures: with as few as here, that says little); differences draw the same views of all."
)
"""The note below every table of two-sided areas."""


def summary_grid(by_stegexpose: ByMethod, by_learning: ByMethod, by_attributes: ByMethod) -> Grid:
    """In words, whether detectors distinguish what each method hides."""

    def file(method: str) -> Cell:
        rows = [row for each in by_attributes.get(method, []) for row in each.rows if row.quantity == ONLY_THERE]
        own = {row.value for row in rows if row.condition == HIDDEN}
        if not own:
            return Cell("not measured")
        names = f"attributes that no clean file has: {max(own):.0f}" if max(own) else "no attribute of its own"
        return Cell(names, widest_divergence(by_attributes[method]))

    methods = dict.fromkeys((*by_stegexpose, *by_learning, *by_attributes))
    return Grid(
        "Is the presence of a message detected?",
        ("Method",),
        ("StegExpose", *(f"A learned detector, on {seen}" for seen in LEARNED.values()), "The published file"),
        tuple(
            Line(
                (title_of(method),),
                (
                    Cell(verdict(by_stegexpose.get(method, []), FUSION)),
                    *(Cell(verdict(by_learning.get(method, []), quantity)) for quantity in LEARNED),
                    file(method),
                ),
            )
            for method in methods
        ),
        (
            "By the areas below. Distinguished: the 95 % interval over all captures stays above chance, and that of "
            f"its excess over two that hide nothing stays above 0; barely, if the area is at most {UNNOTICED:g}. "
            "Not significantly better than two that hide nothing: the interval of this excess reaches 0. Individually "
            f"on some captures, or only on these: both hold there, and the area is above {UNNOTICED:g}. In opposite "
            "directions: on some captures it is the detector's inverse that works, which is of no use to anyone who "
            "does not know where. What no detector here finds may be found by others.",
        ),
    )


def areas_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    """Areas of StegExpose's fusion for each method and comparison, by capture and over all."""
    return Grid(
        "StegExpose's fusion: area under the ROC curve, two-sided",
        ("Method", "Compared"),
        (*map(capture_title, captures), "All captures"),
        tuple(
            line
            for method, experiments in by_method.items()
            for line in _lines((title_of(method),), experiments, FUSION, COMPARISONS, captures)
        ),
        (
            AREA_NOTE,
            "The curves of all captures pool them, as the paper's figure does; they are of the fusion's scores as they "
            "are: below the diagonal, its inverse is better.",
            *(_finding(method, experiments) for method, experiments in by_method.items()),
            "The GS-Hider paper compares renders with photos only, and prints a plot without values. KeySS (ICLR 2026) "
            "reports 0.45 for itself, measured in the same way; two-sided, that is 0.55.",
        ),
    )


def _finding(method: str, experiments: Sequence[Experiment]) -> str:
    """In words, what a method's areas show."""
    photos, rendering = (area_of(experiments, FUSION, comparison) for comparison in (AS_IN_THE_PAPER, RENDERING))
    is_alike = all(
        is_inverted(own, FUSION, AS_IN_THE_PAPER) == is_inverted(own, FUSION, RENDERING)
        for own in by_capture(experiments)
        if area_of(own, FUSION, RENDERING).low > 0.5
    )
    is_rendering = is_alike and rendering.value > photos.value - 0.05
    seen = "mostly that they are renders" if is_rendering else "more than rendering"
    return (
        f"{title_of(method)}: renders against photos have an area of {photos.value:.2f}, and of {rendering.value:.2f} "
        f"where nothing is hidden: what is detected is {seen}. Renders with and without a message: "
        f"{verdict(experiments, FUSION)}."
    )


def _lines(
    names: tuple[str, ...],
    experiments: Sequence[Experiment],
    quantity: str,
    comparisons: Sequence[Comparison],
    captures: Sequence[str],
) -> Iterator[Line]:
    """A line for each comparison, by capture and over all, and one for the excess over two that hide nothing."""
    groups = [*([each for each in experiments if each.capture == capture] for capture in captures), experiments]
    for comparison in comparisons:
        if scores_of(experiments, quantity, comparison):
            yield Line((*names, comparison.title), tuple(area_cell(own, quantity, comparison) for own in groups))
    cells = tuple(excess_cell(own, quantity) for own in groups)
    if any(cell.text for cell in cells):
        yield Line((*names, EXCESS), cells)


def detectors_grid(by_method: ByMethod) -> Grid:
    """Areas of each of StegExpose's detectors over all captures, and the share of pictures without a value."""
    shown = (AS_IN_THE_PAPER, HIDING, CHANCE)
    return Grid(
        "StegExpose's individual detectors, all captures: area under the ROC curve, two-sided",
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
        (AREA_NOTE,),
    )


def _missing(experiments: Sequence[Experiment], detector: str) -> Cell:
    values = [row.value for each in experiments for row in each.rows if row.quantity == detector]
    share = sum(map(math.isnan, values)) / len(values)
    return Cell(f"{100 * share:.0f} %", "", Spread(share))


def learned_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    """Areas of the learned detectors for each method and comparison, by capture and over all."""
    rows = [row for experiments in by_method.values() for each in experiments for row in each.rows]
    counts = sorted({int(row.value) for row in rows if row.quantity == TRAINING_SCENES and row.value > 0})
    return Grid(
        "A network on noise residuals, trained on the other scenes: area under the ROC curve, two-sided",
        ("Method", "Looks at", "Compared"),
        (*map(capture_title, captures), "All captures"),
        tuple(
            line
            for method, experiments in by_method.items()
            for quantity, seen in LEARNED.items()
            for line in _lines((title_of(method), seen), experiments, quantity, (HIDING, CHANCE), captures)
        ),
        (
            *((AREA_NOTE,) if counts else ()),
            f"Each detector knows the method, and was trained on {' or '.join(map(str, counts))} other scene(s), with "
            f"{_seen_of_each(rows)} of each: it may have learnt whatever distinguishes these few, such as the message "
            "where they hide the same one; one trained on hundreds would do better. For detectors that differ only in "
            "their seed, the mean counts. An area near 0.5 is no proof of security; one far from it, and farther than "
            "that of two clean trainings, proves the opposite. Where the inverse is used (↓), what the detector learnt "
            "elsewhere is reversed here."
            if counts
            else "Not measured: this needs renders of at least two captures, one to train on and one to test on.",
        ),
    )


def _seen_of_each(rows: Sequence[Measurement]) -> str:
    """What a detector saw of each scene it learnt from: one pair, or several that differ in seed or message."""
    scenes, pairs = (
        sum(row.value for row in rows if row.quantity == name) for name in (TRAINING_SCENES, TRAINING_PAIRS)
    )
    return (
        "one or more containers and as many clean trainings"
        if pairs > scenes
        else "one container and one clean training"
    )


def counts_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    """The number of pictures of each class, by capture."""

    def most(condition: str, capture: str) -> int:
        counts = [
            sum((row.quantity, row.condition) == (FUSION, condition) for row in each.rows)
            for experiments in by_method.values()
            for each in experiments
            if each.capture == capture
        ]
        return max(counts, default=0)

    stages = dict.fromkeys(each.stage.partition("[")[0] for experiments in by_method.values() for each in experiments)
    return Grid(
        "Pictures of each class",
        ("Class",),
        tuple(map(capture_title, captures)),
        tuple(
            Line((title,), tuple(Cell(str(most(condition, capture))) for capture in captures))
            for condition, title in CLASS_TITLES.items()
        ),
        (
            "Renders are from new cameras along the rig; photos are all that were registered, undistorted and at the "
            "size of the renders. Whatever their numbers, both classes and all scenes have equal weight: the paper "
            "mixes them in equal proportions.",
            f"Every detector's score of every picture: see the measurements of {', '.join(stages)}.",
        ),
    )
