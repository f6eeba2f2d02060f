"""Whether the message is decoded, or known to the decoder by heart: what it shows of features that hold no message."""

from __future__ import annotations

import math

from stages.analysis.page.material import METHOD_TITLES
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import HERE, Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Measured, measure, message
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.analysis.probes import OWN, PROBES, run_name

MOST_OVER_ONE_COLOUR = 1.0
"""In dB: features without a message may show no more of it than this above the best picture of one colour."""


def probes(study: Study, tables: Published) -> Chapter:
    """The rows of `probe_decoder`: a block for each method, a line for each probe."""
    lines, relations, shown = [], [], []
    for method, title in METHOD_TITLES.items():
        runs = {probe: _runs(study, run_name(method, probe)) for probe in PROBES}
        if not any(runs.values()):
            continue
        found = {probe: measure(group, message("psnr_covered")) for probe, group in runs.items()}
        floor = measure(runs[OWN], message("psnr_constant"))
        lines += [
            Line((title, probe, HERE), tuple(measured_cells("psnr", figure, floor, study.captures)))
            for probe, figure in found.items()
        ]
        cells = tuple(measured_cells("psnr", floor, None, study.captures))
        lines.append(Line((title, "one colour, the best", HERE), cells))
        relations += [_relation(title, probe, figure, floor) for probe, figure in found.items() if probe != OWN]
        shown += [run for group in runs.values() for run in group]
    grid = Grid(
        "What the message decoder shows, test views: PSNR over the message's pixels (dB)",
        ("Method", "Features", "Figures"),
        (*headings(study.captures)[:-1], "To one colour"),
        tuple(lines),
        ("The geometry is the container's own, and the decoder the secret one. The paper gives no figures.",),
    )
    return Chapter(
        "Is the message decoded, or known by heart?", (without_empty_columns(grid),), tuple(relations), tuple(shown)
    )


def _runs(study: Study, name: str) -> tuple[Run, ...]:
    return study.select(lambda run: run.method == name)


def _relation(title: str, probe: str, figure: Measured, floor: Measured) -> Relation:
    return Relation(
        f"{title}: message over one colour, {probe}",
        "difference",
        "at most",
        MOST_OVER_ONE_COLOUR,
        figure.minus(floor),
        math.nan,
    )
