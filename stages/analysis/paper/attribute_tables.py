"""How far the attributes of a container's Gaussians diverge from a clean one's, beside two clean ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stages.analysis.attribute_histograms import CHANNELS, DIVERGENCE, GAUSSIANS, HISTOGRAM, ONLY_THERE, of_attribute
from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.detection import ByMethod
from stages.analysis.paper.grid import Cell, Grid, Line
from stages.analysis.paper.measuring import Spread, mean
from stages.analysis.paper.runs import Experiment, capture_title
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN
from stages.scene.spherical_harmonics import SH_BASE

CHARTED = ("logit_opacities", "log_scales", "raw_features", SH_BASE)
CLASS_TITLES = {HIDDEN: "hides a message", CLEAN: "hides nothing", CLEAN_AGAIN: "hides nothing, other seed"}


def attributes_grid(by_method: ByMethod, captures: Sequence[str]) -> Grid:
    """A line for each method and attribute, a column for each capture; notes have the figure of two clean ones."""
    lines = [
        Line((title_of(method), title), tuple(_cell(experiments, quantity, capture, form) for capture in captures))
        for method, experiments in by_method.items()
        for quantity, title, form in _quantities(experiments)
    ]
    return Grid(
        "The container's Gaussians compared with a clean one's: Jensen-Shannon divergence of histograms (bits)",
        ("Method", "Attribute"),
        tuple(map(capture_title, captures)),
        tuple(lines),
        (
            "0: identical; 1: no value in common. Second figures: two clean containers that differ only in their seed. "
            "Nobody who finds a container has its clean twin: a divergence means that there is something to learn, not "
            "that it was learnt. An attribute that only the container has needs no statistics: its name is in the "
            "published file.",
        ),
    )


def widest_divergence(experiments: Sequence[Experiment]) -> str:
    """In words, the attribute whose divergence from a clean container most exceeds that between two clean ones.

    Empty if this was not measured.
    """
    found = []
    for experiment in experiments:
        by_quantity: dict[str, dict[str, float]] = {}
        for row in experiment.rows:
            by_quantity.setdefault(row.quantity, {})[row.condition] = row.value
        for name, title, _ in _quantities([experiment]):
            values = by_quantity[name]
            if name.startswith((f"{DIVERGENCE}: ", f"{CHANNELS}: ")) and {HIDDEN, CLEAN_AGAIN} <= values.keys():
                found.append((values[HIDDEN] - values[CLEAN_AGAIN], title, values[HIDDEN], values[CLEAN_AGAIN]))
    if not found:
        return ""
    _, title, hidden, clean = max(found)
    return f"{title}: {hidden:.3f} bits from a clean one; between two clean ones, {clean:.3f}"


def attribute_charts(by_method: ByMethod) -> Iterator[Chart]:
    """Histograms of the first experiment of each method."""
    for method, (first, *_) in by_method.items():
        for attribute in CHARTED:
            quantity = of_attribute(HISTOGRAM, attribute)
            series = [
                Series(title, _histogram(first, quantity, condition)) for condition, title in CLASS_TITLES.items()
            ]
            title = f"{title_of(method)}, {capture_title(first.capture)}: {attribute}"
            chart = line_chart(title, series, from_zero=False, axes=(attribute, "share of values in each bin"))
            if chart is not None:
                yield chart


def _quantities(experiments: Sequence[Experiment]) -> list[tuple[str, str, str]]:
    """The measured quantities, each with its title and the format of its figures."""
    names = dict.fromkeys(row.quantity for experiment in experiments for row in experiment.rows)
    found = []
    for name in names:
        quantity, _, attribute = name.partition(": ")
        title = {
            DIVERGENCE: attribute,
            CHANNELS: f"{attribute}, channel by channel",
            GAUSSIANS: "number of Gaussians, as a ratio",
            ONLY_THERE: "attributes that the clean one lacks",
        }.get(quantity)
        if title is not None:
            found.append((name, title, "{:.0f}" if quantity == ONLY_THERE else "{:.3f}"))
    return found


def _cell(experiments: Sequence[Experiment], quantity: str, capture: str, form: str) -> Cell:
    """The mean over a capture's experiments, with that of two clean containers as its note."""
    found: dict[str, list[float]] = {}
    for experiment in experiments:
        for row in experiment.rows:
            if (experiment.capture, row.quantity) == (capture, quantity):
                found.setdefault(row.condition, []).append(row.value)
    if HIDDEN not in found:
        return Cell("")
    note = form.format(mean(found[CLEAN_AGAIN])) if CLEAN_AGAIN in found else ""
    return Cell(form.format(mean(found[HIDDEN])), note, Spread(mean(found[HIDDEN])))


def _histogram(experiment: Experiment, quantity: str, condition: str) -> tuple[tuple[float, float], ...]:
    return tuple(
        (row.severity, row.value)
        for row in experiment.rows
        if (row.quantity, row.condition) == (quantity, condition) and row.severity is not None
    )
