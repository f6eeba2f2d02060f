"""Does the decoder decode the message, or has it memorised it? What it shows for features that hold no message."""

from __future__ import annotations

import math

from stages.analysis.method_titles import METHOD_TITLES
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import HERE, Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Measured, measure, message
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import MOST_OVER_ONE_COLOUR, Relation
from stages.analysis.paper.runs import Run, Study
from stages.analysis.paper.settings import settings_title
from stages.analysis.probes import OWN, PROBES, probed


def probes(study: Study, tables: Published) -> Chapter:
    """The chapter on the rows of `probe_decoder`: a block for each method, a line for each probe."""
    lines, relations, shown = [], [], []
    for title, runs in _by_title(study).items():
        found = {probe: measure(group, message("psnr_covered")) for probe, group in runs.items()}
        floor = measure(runs[OWN], message("psnr_constant"))
        lines += [
            Line((title, probe, HERE), tuple(measured_cells("psnr", figure, floor, study.captures)))
            for probe, figure in found.items()
        ]
        cells = tuple(measured_cells("psnr", floor, None, study.captures))
        lines.append(Line((title, "the best single colour", HERE), cells))
        relations += [_relation(title, probe, figure, floor) for probe, figure in found.items() if probe != OWN]
        shown += [run for group in runs.values() for run in group]
    grid = Grid(
        "What the message decoder shows, test views: PSNR over the message's pixels (dB)",
        ("Method", "Features", "Figures"),
        (*headings(study.captures)[:-1], "vs. one colour"),
        tuple(lines),
        ("The geometry is the container's own, and the decoder is the secret one. The preprint gives no figures.",),
    )
    return Chapter(
        "Is the message decoded, or memorised?", (without_empty_columns(grid),), tuple(relations), tuple(shown)
    )


def _by_title(study: Study) -> dict[str, dict[str, list[Run]]]:
    """The runs of each probe, by the title of the method with its unusual settings, in the paper's order of methods."""
    found = [(*named, run) for run in study.runs if (named := probed(run.method)) is not None]
    order = [*METHOD_TITLES, *sorted({method for method, _, _ in found} - METHOD_TITLES.keys())]
    groups: dict[str, dict[str, list[Run]]] = {}
    for method, probe, run in sorted(
        found, key=lambda each: (order.index(each[0]), each[2].settings != (), str(each[2].settings))
    ):
        groups.setdefault(settings_title(method, run.settings), {name: [] for name in PROBES})[probe].append(run)
    return groups


def _relation(title: str, probe: str, figure: Measured, floor: Measured) -> Relation:
    return Relation(
        f"{title}: message over one colour, {probe}",
        "difference",
        "at most",
        MOST_OVER_ONE_COLOUR,
        figure.minus(floor),
        math.nan,
    )
