"""The paper's table "Robustness analysis under different pruning methods", with our figures beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from stages.analysis.attacks.catalogue import UNATTACKED, AttackName
from stages.analysis.method_titles import GS_HIDER, OURS
from stages.analysis.page.figures import label
from stages.analysis.paper.attack_curves import at_severity
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.grid import HERE, PAPER, Cell, Grid, Line, figure_cell, published_cell, some_of
from stages.analysis.paper.measuring import Measured, MeasuredErrors
from stages.analysis.paper.published import Published, Variant, average, published_name
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Experiment
from stages.imaging.lpips_weights import HOW_TO_INSTALL

PRUNINGS: Mapping[str, tuple[str, AttackName]] = {
    "sequential": ("Sequential", "sequential_pruning"),
    "random": ("Random", "random_pruning"),
}
COLUMNS = ((False, "psnr"), (False, "ssim"), (False, "lpips_vgg"), (True, "psnr"), (True, "ssim"))
"""Whether the figure is the message's, and its quantity."""

UNCHANGED = 0.05
"""In dB: sequential pruning of 15 % "changes nothing" if neither picture loses more."""

MOST_LOST_AT_RANDOM = {False: 2.9, True: 1.6}
"""In dB, of cover (False) and message (True), with 25 % of the Gaussians pruned at random."""

Groups = Mapping[str, Sequence[Experiment]]


def pruning_table(by_method: Groups, tables: Published) -> Grid:
    """Averages over captures and seeds, beside the paper's over its nine captures, which are GS-Hider's."""
    lines = _lines("Nothing pruned", by_method, UNATTACKED, None)
    full = tables.all_metrics
    unpruned = (average(full["message" if message else "cover"].get(published_name(name))) for message, name in COLUMNS)
    lines.append(_published_line("Nothing pruned", list(unpruned)))
    for kind, (title, attack) in PRUNINGS.items():
        for variant in tables.pruning[kind]:
            name = f"{title}, {variant.value:g} %"
            lines += _lines(name, by_method, attack, variant.value / 100)
            lines.append(_published_line(name, [_of(variant, message, quantity) for message, quantity in COLUMNS]))
    notes = [
        "Averages over captures (fewer where stated) and over seeds of random pruning (LPIPS: one seed); the paper "
        "does not name the network of its LPIPS."
    ]
    if not at_severity(_all(by_method), UNATTACKED, None, False, "lpips_vgg").by_capture:
        notes.append(f"LPIPS (VGG16) was not measured. If its weights are missing: {HOW_TO_INSTALL}")
    headings = tuple(f"{'Message' if message else 'Cover'}: {label(quantity)}" for message, quantity in COLUMNS)
    return Grid("Pruned Gaussians, test views", ("Pruning", "Method", "Figures"), headings, tuple(lines), tuple(notes))


def pruning_relations(by_method: Groups, tables: Published) -> list[Relation]:
    """The paper's findings, for its own method and for ours, sealed or not."""
    found = []
    methods = [method for method, group in by_method.items() if group[0].method in (GS_HIDER, OURS)]
    unpruned = {False: average(tables.fidelity[GS_HIDER].cover), True: average(tables.fidelity[GS_HIDER].message)}
    for method in methods:
        for kind, percent, text in (("sequential", 15, "15 % sequential"), ("random", 25, "25 % at random")):
            variant = next(each for each in tables.pruning[kind] if each.value == percent)
            for message in (False, True):
                bound = UNCHANGED if kind == "sequential" else MOST_LOST_AT_RANDOM[message]
                difference = _of(variant, message, "psnr") - unpruned[message]
                found.append(
                    Relation(
                        f"{title_of(method)}, {text}: change of the {'message' if message else 'cover'}",
                        "difference",
                        "at least",
                        -bound,
                        _change(by_method[method], PRUNINGS[kind][1], percent / 100, message),
                        difference,
                        source="" if method == GS_HIDER else "of GS-Hider",
                    )
                )
    for method in methods:
        found += [_addition(method, by_method[method], tables, unpruned[message], message) for message in (False, True)]
    return [relation for relation in found if relation.measured.by_capture]


def _addition(
    method: str, experiments: Sequence[Experiment], tables: Published, unpruned: float, message: bool
) -> Relation:
    """The error that pruning a quarter at random adds, as a PSNR: it should add no more than in the paper.

    The better a picture was, the more decibels the same added error costs it.
    """
    variant = next(each for each in tables.pruning["random"] if each.value == 25)
    published = added_psnr(unpruned, _of(variant, message, "psnr"))
    before = at_severity(experiments, UNATTACKED, None, message, "psnr")
    after = at_severity(experiments, PRUNINGS["random"][1], 0.25, message, "psnr")
    picture = "message" if message else "cover"
    return Relation(
        f"{title_of(method)}, 25 % at random: PSNR of the error that pruning adds to the {picture}",
        "figure",
        "at least",
        published,
        MeasuredErrors(before.with_other(after, added_psnr).by_capture),
        published,
        source="" if method == GS_HIDER else "of GS-Hider",
    )


def added_psnr(before: float, after: float) -> float:
    """The PSNR of the error that was added between a picture with PSNR `before` and the same with PSNR `after`, in dB.

    Squared errors are assumed to add up, as if independent. Infinite if nothing was added, NaN if either PSNR is NaN.
    """
    added = 10 ** (-after / 10) - 10 ** (-before / 10)
    return math.inf if added <= 0 else -10 * math.log10(added)


def _change(experiments: Sequence[Experiment], attack: str, share: float, message: bool) -> Measured:
    pruned = at_severity(experiments, attack, share, message, "psnr")
    return pruned.minus(at_severity(experiments, UNATTACKED, None, message, "psnr"))


def _lines(name: str, by_method: Groups, condition: str, severity: float | None) -> list[Line]:
    captures = {each.capture for each in _all(by_method)}
    return [
        Line(
            (name, title_of(method), HERE),
            tuple(
                Cell(figure_cell(quantity, figure.average).text, some_of(figure, captures), figure.average)
                for message, quantity in COLUMNS
                for figure in [at_severity(group, condition, severity, message, quantity)]
            ),
        )
        for method, group in by_method.items()
    ]


def _published_line(name: str, values: Sequence[float]) -> Line:
    cells = (published_cell(quantity, value) for (_, quantity), value in zip(COLUMNS, values, strict=True))
    return Line((name, title_of(GS_HIDER), PAPER), tuple(cells), published=True)


def _of(variant: Variant, message: bool, quantity: str) -> float:
    return (variant.message if message else variant.cover).get(published_name(quantity), float("nan"))


def _all(by_method: Groups) -> list[Experiment]:
    return [each for group in by_method.values() for each in group]
