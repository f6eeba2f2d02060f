"""The table of rendering times: a frame with its decoding, and the feature map alone."""

from __future__ import annotations

import math

from stages.analysis.page.material import GS_HIDER, OURS, PLAIN
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
from stages.analysis.paper.runs import Study

PARTS = {"seconds_per_frame": "Frame", "seconds_per_feature_map": "Feature map"}
SLOWEST = 1.2
NOTE = "The paper's on a GPU, at the sizes of 3DGS; these on the device and at the size of this workflow."


def frame_time(study: Study, tables: Published) -> Chapter:
    """What one picture of the cover takes."""
    runs = study.timings
    captures = study.captures
    lines: list[Line] = []
    for method, title, group in blocks(runs, tables.seconds_per_frame):
        for quantity, part in PARTS.items():
            figure = cover(quantity, None)
            reference = None if method == PLAIN else of_method(runs, PLAIN, figure)
            lines.append(
                Line((title, part, HERE), tuple(measured_cells(quantity, measure(group, figure), reference, captures)))
            )
            if title == title_of(method) and quantity == "seconds_per_frame":
                row = tables.seconds_per_frame.get(method)
                lines.append(
                    Line((title, part, PAPER), tuple(published_cells(quantity, row, None, captures, tables)), True)
                )
    grid = Grid("Time a frame (ms)", ("Method", "Part", "Figures"), headings(captures), tuple(lines), (NOTE,))
    frame, as_usual = cover("seconds_per_frame", None), usual(runs)
    relation = Relation(
        f"{title_of(OURS)}'s time a frame over that of {title_of(GS_HIDER)}",
        "ratio",
        "at most",
        SLOWEST,
        of_method(as_usual, OURS, frame).over(of_method(as_usual, GS_HIDER, frame)),
        math.nan,
    )
    return Chapter("Rendering time", (without_empty_columns(grid),), (relation,), runs)
