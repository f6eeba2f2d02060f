"""The no-message table: what features and a decoder cost beside spherical harmonics, when nothing is hidden."""

from __future__ import annotations

from stages.analysis.page.figures import label
from stages.analysis.page.material import GS_HIDER, PLAIN
from stages.analysis.page.tables import PICTURE_QUANTITIES
from stages.analysis.paper.chapter import (
    Base,
    Chapter,
    at_base,
    base_settings,
    blocks,
    noise_note,
    noises,
    of_method,
    title_of,
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
from stages.analysis.paper.published import PUBLISHED_AS, Published, average
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study, differing

MOST_LOST_WITHOUT_A_MESSAGE = 0.7


def no_message(study: Study, tables: Published) -> Chapter:
    """Runs that hide nothing: with the paper's M and decoder, and with larger ones where there are any."""
    base = base_settings(study, tables)
    runs = study.select(lambda run: not run.messages and not run.hides_image and usual_length(run, study))
    lines: list[Line] = []
    references = {quantity: of_method(runs, PLAIN, cover(quantity)) for quantity in PICTURE_QUANTITIES}
    for method, title, group in blocks(runs, base, (PLAIN, GS_HIDER)):
        for quantity in PICTURE_QUANTITIES:
            reference = None if method == PLAIN else references[quantity]
            cells = measured_cells(quantity, measure(group, cover(quantity)), reference, study.captures)
            lines.append(Line((title, label(quantity), HERE), tuple(cells)))
            if title == title_of(method):
                lines.append(_published_line(method, quantity, study, tables))
    grid = Grid(
        "Nothing hidden, test views",
        ("Method", "Metric", "Figures"),
        headings(study.captures),
        tuple(lines),
        (noise_note({"cover": noises(runs, study)["cover"]}),),
    )
    return Chapter("Without a message", (without_empty_columns(grid),), _relations(runs, study, tables), runs)


def usual_length(run: Run, study: Study) -> bool:
    """Whether a run has the fewest iterations of the study, or does not state them."""
    return dict(run.settings).get("iterations", study.iterations) == study.iterations


def _published_line(method: str, quantity: str, study: Study, tables: Published) -> Line:
    plain = tables.fidelity[PLAIN].cover if quantity == "psnr" else None
    row = plain if method == PLAIN else tables.no_message.get(PUBLISHED_AS.get(quantity, quantity))
    reference = None if method == PLAIN else plain
    cells = published_cells(quantity, row, reference, study.captures, tables)
    return Line((title_of(method), label(quantity), PAPER), tuple(cells), published=True)


def _relations(runs: tuple[Run, ...], study: Study, tables: Published) -> tuple[Relation, ...]:
    base, name, noise = base_settings(study, tables), title_of(GS_HIDER), noises(runs, study)["cover"].deviation
    usual = of_method(at_base(runs, base), GS_HIDER, cover("psnr"))
    larger = of_method([run for run in runs if _is_larger(run, base)], GS_HIDER, cover("psnr"))
    return (
        Relation(
            f"{name} without a message not far under 3DGS",
            "difference",
            "at least",
            -MOST_LOST_WITHOUT_A_MESSAGE,
            usual.minus(of_method(runs, PLAIN, cover("psnr"))),
            average(tables.no_message["psnr"]) - average(tables.fidelity[PLAIN].cover),
            noise,
        ),
        Relation(
            f"{name} without a message: larger features and decoder approach 3DGS",
            "difference",
            "more than",
            0.0,
            larger.minus(usual),
            noise=noise,
            source="said",
        ),
    )


def _is_larger(run: Run, base: Base) -> bool:
    """Whether features or decoder are larger than the paper's, and neither is smaller."""
    changes = [(value, base[name]) for name, value in differing(run, base) if name in ("feature_dim", "layers")]
    return bool(changes) and all(
        isinstance(value, float) and isinstance(usual, float | int) and value > usual for value, usual in changes
    )
