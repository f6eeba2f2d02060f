"""The ablations: λ, the feature dimension M and the number of layers, each varied alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from stages.analysis.page.figures import label
from stages.analysis.page.material import GS_HIDER, METHOD_TITLES
from stages.analysis.paper.chapter import PICTURES, Chapter, noise_note, noises
from stages.analysis.paper.fidelity import hides_one_scene
from stages.analysis.paper.grid import (
    HERE,
    NOT_MEASURED,
    PAPER,
    Cell,
    Grid,
    Line,
    figure_cell,
    published_cell,
    without_empty_columns,
)
from stages.analysis.paper.measuring import Figure, Measured, cover, measure, message
from stages.analysis.paper.published import PUBLISHED_AS, Ablated, Published, Subject, Variant
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study, usual_settings

TITLES: Mapping[Ablated, str] = {"lambda_message": "λ", "feature_dim": "M", "layers": "Layers"}
COLUMNS: tuple[tuple[Subject, str], ...] = (
    *(("cover", quantity) for quantity in ("psnr", "ssim", "lpips_vgg", "lpips_alex")),
    *(("message", quantity) for quantity in ("psnr", "ssim", "lpips_vgg", "lpips_alex")),
)
ORDERS: tuple[tuple[Ablated, float, float, Subject], ...] = (
    ("lambda_message", 0.25, 0.5, "cover"),
    ("lambda_message", 0.5, 1.0, "cover"),
    ("lambda_message", 0.5, 0.25, "message"),
    ("lambda_message", 1.0, 0.5, "message"),
    ("layers", 5, 3, "message"),
    ("layers", 5, 7, "cover"),
    ("layers", 5, 7, "message"),
    ("feature_dim", 16, 8, "cover"),
    ("feature_dim", 16, 32, "cover"),
    ("feature_dim", 16, 8, "message"),
    ("feature_dim", 16, 32, "message"),
)
"""What the paper finds: with the first value the picture is better than with the second."""


def ablations(study: Study, tables: Published) -> Chapter:
    """Runs of one method that differ from the paper's settings in one of them alone."""
    hiding = study.select(hides_one_scene)
    grids, shown = [], list[Run]()
    for method in dict.fromkeys(run.method for run in hiding):
        for name in TITLES:
            runs = varied([run for run in hiding if run.method == method], name)
            if len({value_of(run, name, tables) for run in runs}) > 1:
                grids.append(_grid(method, name, runs, study, tables))
                shown += runs
    ours = [run for run in hiding if run.method == GS_HIDER]
    relations = [_relation(ours, order, study, tables) for order in ORDERS]
    return Chapter("Ablations", tuple(grids), tuple(relations), tuple(dict.fromkeys(shown)))


def varied(runs: Sequence[Run], name: str) -> list[Run]:
    """Those whose other settings are the usual ones."""
    return [run for run in runs if all(other == name for other, _ in run.settings)]


def value_of(run: Run, name: Ablated, tables: Published) -> float | str:
    """A setting of a run: its method's usual one where it states no other."""
    return dict(run.settings).get(name, usual_settings(run.method, tables.setup)[name])


def _grid(method: str, name: Ablated, runs: Sequence[Run], study: Study, tables: Published) -> Grid:
    printed = {variant.value: variant for variant in tables.ablations[name]} if method == GS_HIDER else {}
    values = sorted(
        {*printed, *(value_of(run, name, tables) for run in runs)}, key=lambda value: (isinstance(value, str), value)
    )
    lines: list[Line] = []
    for value in values:
        own = [run for run in runs if value_of(run, name, tables) == value]
        title = f"{value:g}" if isinstance(value, float | int) else value
        lines.append(Line((title, HERE), tuple(_cell(own, subject, quantity) for subject, quantity in COLUMNS)))
        if isinstance(value, float | int) and value in printed:
            lines.append(_published_line(title, printed[value]))
    titles = tuple(f"{PICTURES[subject]} {label(quantity)}" for subject, quantity in COLUMNS)
    captures = len({run.capture for run in runs})
    note = f"Averages over {captures} capture{'s' if captures > 1 else ''}; the paper's over nine."
    return without_empty_columns(
        Grid(
            f"{METHOD_TITLES.get(method, method)}: {TITLES[name]}, test views",
            (TITLES[name], "Figures"),
            titles,
            tuple(lines),
            (note, noise_note(noises(runs, study))),
        )
    )


def _figure(subject: Subject, quantity: str) -> Figure:
    return cover(quantity) if subject == "cover" else message(quantity)


def _cell(runs: Sequence[Run], subject: Subject, quantity: str) -> Cell:
    average = measure(runs, _figure(subject, quantity)).average
    if quantity == "lpips_vgg" and subject == "cover" and runs and not average.count:
        return Cell(NOT_MEASURED)
    return figure_cell(quantity, average)


def _published_line(title: str, variant: Variant) -> Line:
    figures: Mapping[Subject, Mapping[str, float]] = {"cover": variant.cover, "message": variant.message}
    cells = [
        published_cell(quantity, figures[subject].get(PUBLISHED_AS.get(quantity, quantity), math.nan))
        for subject, quantity in COLUMNS
    ]
    return Line((title, PAPER), tuple(cells), published=True)


def _relation(
    runs: Sequence[Run], order: tuple[Ablated, float, float, Subject], study: Study, tables: Published
) -> Relation:
    name, better, worse, subject = order

    def at(value: float) -> Measured:
        chosen = [run for run in varied(runs, name) if value_of(run, name, tables) == value]
        return measure(chosen, _figure(subject, "psnr"))

    printed = {variant.value: getattr(variant, subject)["psnr"] for variant in tables.ablations[name]}
    return Relation(
        f"{TITLES[name]} = {better:g} above {worse:g} on the {subject}",
        "difference",
        "more than",
        0.0,
        at(better).minus(at(worse)),
        printed[better] - printed[worse],
        noises(runs, study)[subject].deviation,
    )
