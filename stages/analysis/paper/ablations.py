"""Ablations of λ, the feature dimension M and the number of layers, each varied alone."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from stages.analysis.method_titles import GS_HIDER, METHOD_TITLES
from stages.analysis.page.figures import label
from stages.analysis.paper.chapter import LPIPS, PICTURES, VIEWS, Chapter, noise_note, noises
from stages.analysis.paper.fidelity import hides_one_scene
from stages.analysis.paper.grid import (
    HERE,
    NOT_MEASURED,
    PAPER,
    Cell,
    Grid,
    Line,
    average_cell,
    published_cell,
    without_empty_columns,
)
from stages.analysis.paper.measuring import Figure, Measured, cover, measure, message
from stages.analysis.paper.message_tables import CAPTION, Shown, messages_grid
from stages.analysis.paper.published import PUBLISHED_AS, Ablated, Published, Subject, Variant
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.analysis.paper.settings import usual_settings

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
"""The paper's findings: with the first value, the picture is better than with the second."""


def ablations(study: Study, tables: Published) -> Chapter:
    """The chapter of runs that differ from their method's usual settings in at most one of them."""
    hiding = study.select(hides_one_scene)
    grids, shown = list[Grid](), list[Run]()
    for method in dict.fromkeys(run.method for run in hiding):
        for name in TITLES:
            runs = varied([run for run in hiding if run.method == method], name)
            if len({value_of(run, name, tables) for run in runs}) > 1:
                grids += _grids(method, name, runs, study, tables)
                shown += runs
    ours = [run for run in hiding if run.method == GS_HIDER]
    relations = [_relation(ours, order, study, tables) for order in ORDERS]
    return Chapter("Ablations", tuple(grids), tuple(relations), tuple(dict.fromkeys(shown)))


def varied(runs: Sequence[Run], name: str) -> list[Run]:
    """The runs whose settings other than `name` are the usual ones."""
    return [run for run in runs if all(other == name for other, _ in run.settings)]


def value_of(run: Run, name: Ablated, tables: Published) -> float | str:
    """The value of a setting in a run; its method's usual one if the run states none."""
    return dict(run.settings).get(name, usual_settings(run.method, tables.setup)[name])


def _grids(method: str, name: Ablated, runs: Sequence[Run], study: Study, tables: Published) -> tuple[Grid, ...]:
    """Test views beside the paper's, messages on legal views and covered pixels, and training views."""
    own = _by_value(runs, name, tables)
    grids = (
        _grid(method, name, "test", own, study, tables),
        messages_grid(
            f"{_caption(method, name)}, messages: {CAPTION}",
            (TITLES[name],),
            [Shown((_written(value),), group) for value, group in own.items()],
        ),
        _grid(method, name, "train", own, study, tables),
    )
    return tuple(grid for grid in grids if grid.lines)


def _caption(method: str, name: Ablated) -> str:
    return f"{METHOD_TITLES.get(method, method)}: {TITLES[name]}"


def _by_value(runs: Sequence[Run], name: Ablated, tables: Published) -> dict[float | str, list[Run]]:
    """The runs of each value: numbers in ascending order, then texts."""
    values = sorted({value_of(run, name, tables) for run in runs}, key=_order)
    return {value: [run for run in runs if value_of(run, name, tables) == value] for value in values}


def _order(value: float | str) -> tuple[bool, float | str]:
    return isinstance(value, str), value


def _written(value: float | str) -> str:
    return f"{value:g}" if isinstance(value, float | int) else value


def _grid(
    method: str, name: Ablated, split: str, own: Mapping[float | str, Sequence[Run]], study: Study, tables: Published
) -> Grid:
    """A line for each value; for GS-Hider on test views, also the paper's."""
    is_theirs = method == GS_HIDER and split == "test"
    printed = {variant.value: variant for variant in tables.ablations[name]} if is_theirs else {}
    runs = [run for group in own.values() for run in group]
    captures = {run.capture for run in runs}
    lines: list[Line] = []
    for value in sorted({*printed, *own}, key=_order):
        cells = tuple(_cell(own.get(value, []), subject, quantity, split, captures) for subject, quantity in COLUMNS)
        lines.append(Line((_written(value), HERE), cells))
        if isinstance(value, float | int) and value in printed:
            lines.append(_published_line(_written(value), printed[value]))
    note = f"Averages over {len(captures)} captures, or as many as stated"
    if len(captures) == 1:
        note = "Averages over 1 capture"
    notes = (f"{note}; the paper's: over nine.", noise_note(noises(runs, study))) if split == "test" else (f"{note}.",)
    return without_empty_columns(
        Grid(
            f"{_caption(method, name)}, {VIEWS[split]}",
            (TITLES[name], "Figures"),
            tuple(f"{PICTURES[subject]} {label(quantity)}" for subject, quantity in COLUMNS),
            tuple(lines),
            notes,
        )
    )


def _figure(subject: Subject, quantity: str, split: str = "test") -> Figure:
    return cover(quantity, split) if subject == "cover" else message(quantity, split)


def _cell(runs: Sequence[Run], subject: Subject, quantity: str, split: str, captures: Collection[str]) -> Cell:
    measured = measure(runs, _figure(subject, quantity, split))
    if quantity in LPIPS and split == "test" and subject == "cover" and runs and not measured.by_capture:
        return Cell(NOT_MEASURED)
    return average_cell(quantity, measured, captures)


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
        noises(runs, study)[subject],
    )
