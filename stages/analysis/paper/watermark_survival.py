"""The table of what watermarks survive: renders detected after distortions, and false positives after the same ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from stages.analysis.page.figures import MISSING
from stages.analysis.paper.grid import Cell, Grid, Line, some_of
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.watermark_figures import (
    Key,
    captures_of,
    figures_by_capture,
    percent_cell,
    title_of_key,
    value_of,
)
from stages.analysis.watermark_trials import (
    CLEAN_CHANNEL,
    CONTAINER_WORDING,
    DETECTED,
    FALSE_POSITIVES,
    FALSE_POSITIVES_DISTORTED,
    NEGATIVES_DISTORTED,
    OTHER_SCENES,
    TRIALS,
)
from stages.imaging.distortions import DISTORTIONS, WORDING

SURVIVAL_NOTE = (
    "Test views and new cameras along the rig. For decoders, at the threshold that 99 % of other new cameras reach, "
    "but at most 0.9 of the watermark, so that distorted renders can reach it, too; for grain, at its owner's, which "
    "one picture in 1.6 million reaches by chance (of smaller and cropped ones, which get two looks, one in 815,000). "
    "Sigmas are true standard deviations."
)
ALARMS_NOTE = (
    "False positives: pictures of other scenes, at the same threshold; in the first line all of them, undistorted, and "
    "below a random sample of them after each distortion. So few say little: if none of 300 is wrong, the rate is "
    "below 1 %, at 95 % confidence. (–: not measured.)"
)


def survival(detections: Mapping[Key, Sequence[Experiment]]) -> Grid:
    """The share of renders detected after each distortion and, if measured, the false positives in other scenes."""
    tried = {key for key, group in detections.items() if any(map(_has_distorted_negatives, group))}
    headings: list[str] = []
    for key in detections:
        headings += [title_of_key(key), *([f"{title_of_key(key)}: false positives"] if key in tried else [])]
    lines = []
    captures = captures_of(detections)
    for title, name, severity in _conditions(detections):
        cells: list[Cell] = []
        for key, group in detections.items():
            found = figures_by_capture(group, DETECTED, name, severity)
            cells.append(percent_cell(found.average.mean, some_of(found, captures)))
            if key in tried:
                cells.append(_alarms(group, name, severity))
        lines.append(Line((title,), tuple(cells)))
    return Grid(
        "Renders detected",
        ("Distortion",),
        tuple(headings),
        tuple(lines) if detections else (),
        (SURVIVAL_NOTE, ALARMS_NOTE) if tried else (SURVIVAL_NOTE,),
    )


def _conditions(detections: Mapping[Key, Sequence[Experiment]]) -> list[tuple[str, str, float | None]]:
    """Title, name and severity of each condition."""
    conditions: list[tuple[str, str, float | None]] = [(CLEAN_CHANNEL, CLEAN_CHANNEL, None)]
    conditions += [(f"{WORDING[each.name]} {each.severity:g}", each.name, each.severity) for each in DISTORTIONS]
    attacked = dict.fromkeys(
        (row.condition, row.severity)
        for group in detections.values()
        for each in group
        for row in each.rows
        if row.quantity == DETECTED and row.condition in CONTAINER_WORDING
    )
    return conditions + [(f"{CONTAINER_WORDING[name]} {severity:g}", name, severity) for name, severity in attacked]


def _has_distorted_negatives(experiment: Experiment) -> bool:
    return any(row.quantity == NEGATIVES_DISTORTED for row in experiment.rows)


def _alarms(group: Iterable[Experiment], name: str, severity: float | None) -> Cell:
    """The share of false positives among other scenes' pictures after a distortion, over all captures."""
    quantities, condition = (NEGATIVES_DISTORTED, FALSE_POSITIVES_DISTORTED), name
    if name == CLEAN_CHANNEL:
        quantities, condition = (TRIALS, FALSE_POSITIVES), OTHER_SCENES
    figures = [[value_of(each.rows, quantity, condition, severity) for quantity in quantities] for each in group]
    tried = [pair for pair in figures if pair[0] > 0]
    if not tried:
        return Cell(MISSING)
    count, wrong = (sum(each) for each in zip(*tried, strict=True))
    return Cell(f"{100 * wrong / count:.2f} %", f"{wrong:,.0f} of {count:,.0f}", Spread(wrong / count))
