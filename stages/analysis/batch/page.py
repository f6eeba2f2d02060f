"""The batch's page as data for the template and as HTML, and the same figures as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from pipeline.plain_text import listed
from stages.analysis.batch.results import (
    COVER,
    ITEM,
    MESSAGE,
    OWNER_FIGURES,
    PUBLIC_FIGURES,
    REFERENCE,
    SCENE,
    Figure,
    Result,
    mean_figure,
    measured,
)
from stages.analysis.page.figures import MISSING, WORDING, label, write_figure, write_seconds
from stages.analysis.page.headings import first_columns
from stages.analysis.page.html import fill, templates_beside
from stages.analysis.page.placed import Placed
from stages.analysis.page.summary import Tile
from stages.scene.remarks import HARDLY_SEEN

RESOURCES = ("templates/*",)
TEMPLATES = templates_beside(__file__)
OWNER_SUBJECTS = {
    COVER: "Cover, test views",
    MESSAGE: "Message, test views",
    REFERENCE: "3DGS of the cover alone",
    SCENE: "Container",
}
PUBLIC_SUBJECTS = {COVER: "Test views", REFERENCE: "3DGS alone", SCENE: "Scene"}


@dataclass(frozen=True)
class Line:
    """A row of the table: its names, its formatted figures, and the cause if it failed."""

    names: tuple[str, ...]
    cells: tuple[str, ...]
    cause: str = ""


@dataclass(frozen=True)
class BatchPage:
    """The page's data. `groups` are headings, each with the number of columns it spans; `means` may be None."""

    title: str
    summary: str
    tiles: tuple[Tile, ...]
    names: tuple[str, ...]
    groups: tuple[tuple[str, int], ...]
    headings: tuple[str, ...]
    lines: tuple[Line, ...]
    means: Line | None
    note: str
    definitions: tuple[tuple[str, str], ...]
    notices: tuple[str, ...] = ()

    @property
    def starts(self) -> tuple[int, ...]:
        """The first column of each group."""
        return first_columns(self.groups)


def owner_page(results: Sequence[Result], workflow: str) -> BatchPage:
    """The page with all results, failed ones included, in the order of the batch."""
    made = [result for result in results if result.made]
    failed = len(results) - len(made)
    told = f"{len(made)} of {len(results)} made" + (f", {failed} failed" if failed else "")
    tiles = (
        Tile("Made", f"{len(made)} of {len(results)}", f"{failed} failed" if failed else ""),
        *_tile("Cover, test views", made, OWNER_FIGURES, Figure(COVER, OWNER_FIGURES[0].column)),
        *_tile("Message, test views", made, OWNER_FIGURES, Figure(MESSAGE, OWNER_FIGURES[0].column)),
        *_tile("3DGS of the cover alone", made, OWNER_FIGURES, Figure(REFERENCE, OWNER_FIGURES[0].column)),
    )
    names = tuple(dict.fromkeys((ITEM, *(name for result in results for name in result.values))))
    note = (
        "Item: what `show` calls the scores of a row; its other results have the same brackets. Time: all stages "
        "behind a row together; stages shared by several rows count in each."
    )
    page = _page(workflow, f"{told}.", tiles, names, results, OWNER_FIGURES, OWNER_SUBJECTS, note)
    rows = [" · ".join(filter(None, result.values.values())) or result.item for result in made if result.hardly_seen]
    return replace(page, notices=(f"{listed(rows)}: {HARDLY_SEEN}",) if rows else ())


def public_page(results: Sequence[Result], columns: Sequence[str]) -> BatchPage:
    """The successful scenes, in words that fit any splatted scenes; their names come from the public `columns`."""
    scenes = [result for result in results if result.made]
    made = [
        Result("", {"Scene": name}, result.figures, math.nan)
        for name, result in zip(_scene_names(scenes, columns), scenes, strict=True)
    ]
    summary = "Scenes of 3D Gaussians, compared with held-out photos."
    tiles = (
        Tile("Scenes", str(len(made)), ""),
        *_tile("Test views", made, PUBLIC_FIGURES, PUBLIC_FIGURES[0]),
    )
    title = "Gaussian splatting scenes"
    return _page(title, summary, tiles, ("Scene",), made, PUBLIC_FIGURES, PUBLIC_SUBJECTS, "")


def write_page(page: BatchPage) -> str:
    """The page as self-contained HTML: it has no script and fetches nothing."""
    return fill("batch.html", page, TEMPLATES)


def write_table(results: Sequence[Result], wanted: Sequence[Figure], names: Sequence[str]) -> str:
    """The figures as CSV: a header, and a line for each result, with six significant digits; empty if not measured."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*names, *(f"{figure.subject}_{figure.column.quantity}" for figure in wanted), "seconds", "failed"])
    for result in results:
        figures = ["" if math.isnan(value) else f"{value:.6g}" for value in (*result.figures, result.seconds)]
        writer.writerow([*result.names(names), *figures, result.cause or ""])
    return text.getvalue()


def _page(
    title: str,
    summary: str,
    tiles: tuple[Tile, ...],
    names: tuple[str, ...],
    results: Sequence[Result],
    wanted: Sequence[Figure],
    subjects: Mapping[str, str],
    note: str,
) -> BatchPage:
    shown = measured(results, wanted)
    timed = any(not math.isnan(result.seconds) for result in results)
    placed = any(result.placed for result in results)
    groups = [(subjects[name], len(list(group))) for name, group in groupby(wanted[index].subject for index in shown)]
    made = [result for result in results if result.made]
    quantities = dict.fromkeys(wanted[index].column.quantity for index in shown)
    seconds = math.fsum(result.seconds for result in made) / len(made) if made else math.nan
    means = [_mean(made, wanted[index], index) for index in shown]
    return BatchPage(
        title=title,
        summary=summary,
        tiles=tiles,
        names=names,
        groups=(*groups, *([("Photos", 1)] if placed else []), *([("Work", 1)] if timed else [])),
        headings=(
            *(label(wanted[index].column.quantity) for index in shown),
            *(["Placed"] if placed else []),
            *(["Time"] if timed else []),
        ),
        lines=tuple(_line(result, names, wanted, shown, placed, timed) for result in results),
        means=Line((f"Mean of {len(made)}",), (*means, *([""] if placed else []), *([_time(seconds)] if timed else [])))
        if len(made) > 1
        else None,
        note=note,
        definitions=tuple(WORDING[quantity] for quantity in quantities),
    )


def _mean(made: Sequence[Result], figure: Figure, index: int) -> str:
    """The mean of a figure, and of how many rows it is if not of all."""
    known = sum(not math.isnan(result.figures[index]) for result in made)
    mean = write_figure(figure.column.quantity, mean_figure(made, index))
    return mean if known in (0, len(made)) else f"{mean} (of {known})"


def _line(
    result: Result, names: Sequence[str], wanted: Sequence[Figure], shown: Sequence[int], placed: bool, timed: bool
) -> Line:
    cells = [write_figure(wanted[index].column.quantity, result.figures[index]) for index in shown]
    return Line(
        result.names(names),
        (*cells, *([_placed(result.placed)] if placed else []), *([_time(result.seconds)] if timed else [])),
        result.cause or "",
    )


def _placed(scenes: Sequence[Placed]) -> str:
    """The number of placed photos of each scene, by the name of its stage in the workflow."""
    counts = {scene.stage.partition("[")[0]: f"{scene.registered} of {scene.total}" for scene in scenes}
    return ", ".join(f"{stage} {count}" for stage, count in counts.items()) or MISSING


def _time(seconds: float) -> str:
    return MISSING if math.isnan(seconds) else write_seconds(seconds)


def _tile(name: str, made: Sequence[Result], wanted: Sequence[Figure], figure: Figure) -> list[Tile]:
    """A tile with the mean of a figure and its range; none if it was not measured."""
    index = list(wanted).index(figure)
    values = [result.figures[index] for result in made if not math.isnan(result.figures[index])]
    if not values:
        return []
    low, high = (write_figure(figure.column.quantity, value) for value in (min(values), max(values)))
    mean = write_figure(figure.column.quantity, mean_figure(made, index))
    return [Tile(name, f"{mean} dB", f"mean; {low} to {high}" if len(values) > 1 else "")]


def _scene_names(results: Sequence[Result], columns: Sequence[str]) -> list[str]:
    """A name for each result: the last components of the paths in the public columns, or its number without any.

    Different paths that end alike are numbered, so that their scenes can be told apart without more of the paths.
    """
    paths = [tuple(result.values.get(column, "") for column in columns) for result in results]
    ends = {path: " · ".join(filter(None, (Path(part).name for part in path))) for path in paths}
    counts, seen = Counter(ends.values()), Counter[str]()
    names: dict[tuple[str, ...], str] = {}
    for path, end in ends.items():
        seen[end] += 1
        names[path] = f"{end} {seen[end]}" if end and counts[end] > 1 else end
    return [names[path] or str(number) for number, path in enumerate(paths, start=1)]
