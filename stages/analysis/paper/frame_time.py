"""The table of rendering times: a decoded frame, and the feature map alone."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stages.analysis.method_titles import GS_HIDER, OURS
from stages.analysis.paper.chapter import Chapter, blocks, of_method, title_of, usual
from stages.analysis.paper.grid import (
    HERE,
    PAPER,
    Grid,
    Line,
    headings,
    measured_cells,
    published_cells,
    without_empty_columns,
)
from stages.analysis.paper.measuring import cover, measure
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.hiding.method_names import PLAIN

PARTS = {"seconds_per_frame": "Frame", "seconds_per_feature_map": "Feature map"}
SLOWEST = 1.2
NOTE = (
    "The paper's times are on a GPU at the sizes of 3DGS, and its code also runs the message decoder; these are on "
    "this workflow's device at its size, and decode the cover alone."
)


def frame_time(study: Study, tables: Published) -> Chapter:
    """The chapter on the time that one picture of the cover takes."""
    runs, captures = study.timings, study.captures
    lines: list[Line] = []
    for method, title, group in _kinds(study, tables):
        for quantity, part in PARTS.items():
            figure = cover(quantity, None)
            reference = None if method == PLAIN else of_method(usual(runs), PLAIN, figure)
            lines.append(
                Line((title, part, HERE), tuple(measured_cells(quantity, measure(group, figure), reference, captures)))
            )
            if title == title_of(method) and quantity == "seconds_per_frame":
                row = tables.seconds_per_frame.get(method)
                lines.append(
                    Line((title, part, PAPER), tuple(published_cells(quantity, row, None, captures, tables)), True)
                )
    grid = Grid("Time per frame (ms)", ("Method", "Part", "Figures"), headings(captures), tuple(lines), (NOTE,))
    frame, as_usual = cover("seconds_per_frame", None), usual([run for run in runs if not _hides_nothing(run, study)])
    relation = Relation(
        f"{title_of(OURS)}'s time per frame over that of {title_of(GS_HIDER)}",
        "ratio",
        "at most",
        SLOWEST,
        of_method(as_usual, OURS, frame).over(of_method(as_usual, GS_HIDER, frame)),
        math.nan,
    )
    return Chapter("Rendering time", (without_empty_columns(grid),), (relation,), runs)


def _kinds(study: Study, tables: Published) -> Iterator[tuple[str, str, tuple[Run, ...]]]:
    """As `blocks`, but with a title of their own for containers that hide nothing."""
    for method, title, group in blocks(study.timings, tables.seconds_per_frame):
        nothing = tuple(run for run in group if _hides_nothing(run, study))
        if len(nothing) < len(group) or not group:
            yield method, title, tuple(run for run in group if run not in nothing)
        if nothing:
            yield method, f"{title}, without a message", nothing


def _hides_nothing(timed: Run, study: Study) -> bool:
    """Whether a timed container hides nothing: timings name no message, so the scores of the same training tell."""
    training = (timed.capture, timed.method, timed.settings, timed.seed, timed.other)
    scored = study.select(lambda run: training == (run.capture, run.method, run.settings, run.seed, run.other))
    return timed.method != PLAIN and bool(scored) and not any(run.messages for run in scored)
