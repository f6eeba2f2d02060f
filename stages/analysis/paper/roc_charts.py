"""ROC curves as charts: as in the paper's figure, and others that separate rendering, hiding and chance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.detection import CHANCE, COMPARISONS, RENDERING, ByMethod, scores_of
from stages.analysis.paper.runs import capture_title
from stages.analysis.roc import roc_curve
from stages.analysis.stegexpose.fusion import FUSION

MOST_POINTS = 120
"""Largest number of points of a curve in a chart: more cannot be seen."""


def roc_charts(by_method: ByMethod, captures: Sequence[str]) -> Iterator[Chart]:
    """StegExpose's curves, as in the paper's figure and against clean renders, by capture and pooled over several.

    They are of its scores as they are: below the diagonal its inverse is better, which tables then score.
    """
    groups: Mapping[str, Sequence[str]] = {capture_title(capture): [capture] for capture in captures}
    if len(captures) > 1:
        groups = {"All captures": captures, **groups}
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
                    f"StegExpose, {title}: {comparison.title}",
                    [*series, Series("chance", ((0.0, 0.0), (1.0, 1.0)))],
                    from_zero=False,
                    axes=("false positive rate", "true positive rate"),
                )
                if chart is not None:
                    yield chart


def _thinned(curve: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    step = max(1, math.ceil(len(curve) / MOST_POINTS))
    return (*curve[:-1:step], *curve[-1:])
