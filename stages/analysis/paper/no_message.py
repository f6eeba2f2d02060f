"""The no-message table: the cost of features and decoder compared with spherical harmonics, if nothing is hidden."""

from __future__ import annotations

import math

from stages.analysis.method_titles import GS_HIDER
from stages.analysis.page.figures import label
from stages.analysis.page.tables import PICTURE_QUANTITIES
from stages.analysis.paper.chapter import (
    LPIPS,
    Chapter,
    blocks,
    noise_note,
    noises,
    of_method,
    title_of,
    usual,
)
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
from stages.analysis.paper.published import Published, average, published_name
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.analysis.paper.settings import BUILDING, usual_settings
from stages.hiding.method_names import PLAIN

MOST_LOST_WITHOUT_A_MESSAGE = 0.7


def no_message(study: Study, tables: Published) -> Chapter:
    """The chapter of runs that hide nothing: with the paper's M and decoder, and with larger ones, if there are any."""
    runs = study.select(lambda run: not run.messages and not run.hides_image and "iterations" not in dict(run.settings))
    lines: list[Line] = []
    references = {quantity: of_method(usual(runs), PLAIN, cover(quantity)) for quantity in PICTURE_QUANTITIES}
    for method, title, group in blocks(runs, (PLAIN, GS_HIDER)):
        for quantity in PICTURE_QUANTITIES:
            reference = None if method == PLAIN else references[quantity]
            expected = quantity in LPIPS and bool(group)
            cells = measured_cells(quantity, measure(group, cover(quantity)), reference, study.captures, expected)
            lines.append(Line((title, label(quantity), HERE), tuple(cells)))
            if title == title_of(method) and method in (PLAIN, GS_HIDER):  # the paper has figures of these alone
                lines.append(_published_line(method, quantity, study, tables))
    grid = Grid(
        "Nothing hidden, test views",
        ("Method", "Metric", "Figures"),
        headings(study.captures),
        tuple(lines),
        (noise_note({"cover": noises(runs, study)["cover"]}),),
    )
    return Chapter("Without a message", (without_empty_columns(grid),), _relations(runs, study, tables), runs)


def _published_line(method: str, quantity: str, study: Study, tables: Published) -> Line:
    plain = tables.fidelity[PLAIN].cover if quantity == "psnr" else None
    row = plain if method == PLAIN else tables.no_message.get(published_name(quantity))
    reference = None if method == PLAIN else plain
    cells = published_cells(quantity, row, reference, study.captures, tables)
    return Line((title_of(method), label(quantity), PAPER), tuple(cells), published=True)


def _relations(runs: tuple[Run, ...], study: Study, tables: Published) -> tuple[Relation, ...]:
    name, noise = title_of(GS_HIDER), noises(runs, study)["cover"]
    own = [run for run in runs if run.method == GS_HIDER]
    bare = of_method([run for run in usual(own) if not _builds(run)], GS_HIDER, cover("psnr"))
    larger = measure([run for run in own if _is_larger(run, tables)], cover("psnr"))
    return (
        Relation(
            f"{name} without a message not far below 3DGS",
            "difference",
            "at least",
            -MOST_LOST_WITHOUT_A_MESSAGE,
            bare.minus(of_method(usual(runs), PLAIN, cover("psnr"))),
            average(tables.no_message["psnr"]) - average(tables.fidelity[PLAIN].cover),
            noise,
        ),
        Relation(
            f"{name} without a message: larger features and decoder come closer to 3DGS",
            "difference",
            "more than",
            0.0,
            larger.minus(bare),
            noise=noise,
            source="stated",
        ),
    )


def _builds(run: Run) -> dict[str, float | str]:
    """The settings of features and decoder that are not the usual ones."""
    return {name: value for name, value in run.settings if name in BUILDING}


def _is_larger(run: Run, tables: Published) -> bool:
    """Whether features or decoder are larger than the paper's, and neither is smaller."""
    values, built = usual_settings(run.method, tables.setup), _builds(run)
    return bool(built) and all(
        isinstance(value, float) and value > values.get(name, math.inf) for name, value in built.items()
    )
