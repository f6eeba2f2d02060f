"""A chapter: our figures beside those of one of the paper's tables, and the relations that should hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from stages.analysis.method_titles import METHOD_TITLES
from stages.analysis.page.chart import Chart
from stages.analysis.page.figures import write_figure
from stages.analysis.page.summary import Tile
from stages.analysis.paper.grid import Grid
from stages.analysis.paper.measuring import UNMEASURED, Figure, Measured, Noise, cover, measure, message, noise
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study, capture_title, method_title

PICTURES = {"cover": "Cover", "message": "Message"}
VIEWS = {"test": "test views", "train": "training views"}
"""Titles of the splits."""
LPIPS = {"lpips_vgg": "VGG16", "lpips_alex": "AlexNet"}
"""Quantities that need weights, of these networks; tables say so if they were not measured on test views."""


@dataclass(frozen=True)
class Chapter:
    """A chapter of the page; `charts` are below its tables, `runs` are those that it shows."""

    title: str
    grids: tuple[Grid, ...]
    relations: tuple[Relation, ...] = ()
    runs: tuple[Run, ...] = ()
    tiles: tuple[Tile, ...] = ()
    charts: tuple[Chart, ...] = ()


Writer = Callable[[Study, Published], Chapter]


def usual(runs: Iterable[Run]) -> tuple[Run, ...]:
    """The runs of each method with the usual settings, or all of its runs if it has none of these."""
    listed = list(runs)
    methods = {run.method for run in listed if not run.settings}
    return tuple(run for run in listed if run.method not in methods or not run.settings)


def blocks(runs: Sequence[Run], methods: Collection[str] = ()) -> Iterator[tuple[str, str, tuple[Run, ...]]]:
    """Yield method, title and runs of each kind, in the paper's order; those in `methods` even without runs.

    The title is the method's alone if the settings are the usual ones.
    """
    present = {*methods, *(run.method for run in runs)}
    for method in [*(name for name in METHOD_TITLES if name in present), *sorted(present - METHOD_TITLES.keys())]:
        titled: dict[str, list[Run]] = {title_of(method): []} if method in methods else {}
        for run in runs:
            if run.method == method:
                titled.setdefault(method_title(run), []).append(run)
        for title, group in titled.items():
            yield method, title, tuple(group)


def of_method(runs: Iterable[Run], method: str, figure: Figure) -> Measured:
    """A figure of one method's runs; UNMEASURED if they have several settings, for their mean is a figure of none."""
    own = [run for run in runs if run.method == method]
    return measure(own, figure) if len({run.settings for run in own}) < 2 else UNMEASURED


def title_of(method: str) -> str:
    """The method's title in tables."""
    return METHOD_TITLES.get(method, method)


def noises(runs: Sequence[Run], study: Study, quantity: str = "psnr") -> dict[str, Noise]:
    """Noise of cover and message from one seed to the next: in these runs or in the whole study, whichever is larger.

    If only one method was repeated among these runs, its noise would otherwise stand for that of all.
    """
    found = {}
    for picture, figure in (("cover", cover(quantity)), ("message", message(quantity))):
        own, of_all = noise(runs, figure), noise(study.runs, figure)
        found[picture] = own if own.deviation >= of_all.deviation else of_all
    return found


def _written_runs(spread: Noise) -> str:
    captures = [capture_title(capture) for capture in spread.captures]
    return f"{spread.count} runs" + (f" on {', '.join(captures)}" if any(spread.captures) else "")


def noise_note(spreads: Mapping[str, Noise], quantity: str = "psnr", unit: str = " dB") -> str:
    """The line under a table that states the size of its noise."""
    told = [
        f"{write_figure(quantity, spread.deviation)}{unit} on the {picture} ({_written_runs(spread)}, pooled; of those "
        f"that vary most {write_figure(quantity, spread.largest)})"
        for picture, spread in spreads.items()
        if not math.isnan(spread.deviation)
    ]
    if not told:
        return (
            "The noise was not measured here: no two runs differ only in their seed. To measure it, repeat a row with "
            "other seeds."
        )
    return f"Standard deviation from one seed to the next: {' and '.join(told)}."
