"""Whether the message is decoded, or known to the decoder by heart: what it shows of features that hold no message."""

from __future__ import annotations

import math

from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import HERE, Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Measured, measure, message
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Study
from stages.analysis.probes import OWN, PROBES

MOST_OVER_ONE_COLOUR = 1.0
"""In dB: features without a message may show no more of it than this above the best picture of one colour."""


def probes(study: Study, tables: Published) -> Chapter:
    """The rows of `probe_decoder`, whose methods are the probes."""
    shown = {name: tuple(run for run in study.runs if run.method == name) for name in PROBES}
    runs = tuple(run for group in shown.values() for run in group)
    found = {name: measure(group, message("psnr_covered")) for name, group in shown.items()}
    floor = measure(shown[OWN], message("psnr_constant"))
    lines = [
        Line((name, HERE), tuple(measured_cells("psnr", figure, floor, study.captures)))
        for name, figure in found.items()
    ]
    lines.append(Line(("one colour, the best", HERE), tuple(measured_cells("psnr", floor, None, study.captures))))
    grid = Grid(
        "What the message decoder shows, test views: PSNR over the message's pixels (dB)",
        ("Features", "Figures"),
        (*headings(study.captures)[:-1], "To one colour"),
        tuple(lines),
        ("The geometry is the container's own, and the decoder the secret one. The paper gives no figures.",),
    )
    relations = tuple(_relation(name, figure, floor) for name, figure in found.items() if name != OWN)
    return Chapter("Is the message decoded, or known by heart?", (without_empty_columns(grid),), relations, runs)


def _relation(name: str, figure: Measured, floor: Measured) -> Relation:
    return Relation(
        f"Message over one colour, {name}", "difference", "at most", MOST_OVER_ONE_COLOUR, figure.minus(floor), math.nan
    )
