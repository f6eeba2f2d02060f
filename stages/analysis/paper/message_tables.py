"""Messages on legal views and over the pixels that they cover: a table that several chapters share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from stages.analysis.page.figures import MISSING
from stages.analysis.page.tables import Column
from stages.analysis.paper.grid import Cell, Grid, Line, figure_cell, without_empty_columns
from stages.analysis.paper.measuring import UNKNOWN, measure, message, messages_of
from stages.analysis.paper.runs import Run, capture_title

CAPTION = "legal views and covered pixels, test views"


COLUMNS: Mapping[str, Column] = {
    "PSNR (dB)": Column("psnr", "test"),
    "Legal views": Column("legal", "test"),
    "PSNR, legal (dB)": Column("psnr", "test", only_legal=True),
    "SSIM, legal": Column("ssim", "test", only_legal=True),
    "PSNR, covered (dB)": Column("psnr_covered", "test"),
    "SSIM, covered": Column("ssim_covered", "test"),
    "One colour (dB)": Column("psnr_constant", "test"),
    "Coverage": Column("coverage", "test"),
    "PSNR, training (dB)": Column("psnr", "train"),
}


@dataclass(frozen=True)
class Shown:
    """Runs of one kind, and the names of their line; over all their messages, or only the one at `number`, from 0."""

    names: tuple[str, ...]
    runs: Sequence[Run]
    number: int | None = None


def messages_grid(caption: str, names: tuple[str, ...], shown: Iterable[Shown]) -> Grid:
    """A line for each of `shown` and each of its captures, with the floor that the best single colour sets."""
    lines = []
    for each in shown:
        for capture in dict.fromkeys(run.capture for run in each.runs):
            own = [run for run in each.runs if run.capture == capture]
            cells = tuple(_cell(own, column, each.number) for column in COLUMNS.values())
            lines.append(Line((*each.names, capture_title(capture)), cells))
    return without_empty_columns(Grid(caption, (*names, "Capture"), tuple(COLUMNS), tuple(lines)))


def _cell(runs: Sequence[Run], column: Column, number: int | None) -> Cell:
    figure = message(column.quantity, column.split, column.only_legal, number)
    spread = next(iter(measure(runs, figure).by_capture.values()), UNKNOWN)
    if column.quantity != "legal":
        return figure_cell(column.quantity, spread)
    flags = [flag for run in _one_of_each(runs) for flag in _legal(run, number)]
    return Cell(f"{round(sum(flags))} of {len(flags)}" if flags else MISSING, "", spread)


def _one_of_each(runs: Sequence[Run]) -> list[Run]:
    """One run for each message: which views are legal depends on the message, not on the seed."""
    return [*{run.other: run for run in reversed(runs)}.values()][::-1]


def _legal(run: Run, number: int | None) -> list[float]:
    """For each test view, 1 if it is legal, else 0."""
    names = messages_of(run, number)
    return [row.value for row in run.rows if (row.quantity, row.split) == ("legal", "test") and row.message in names]
