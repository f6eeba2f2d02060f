"""A table as the page, the Markdown file and the CSV file take it."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from stages.analysis.page.figures import MISSING, write_figure
from stages.analysis.paper.measuring import UNKNOWN, Measured, Spread
from stages.analysis.paper.published import Published, Row, average
from stages.analysis.paper.runs import capture_title

HERE, PAPER = "here", "paper"
AVERAGE, DIFFERENCE = "Average", "To 3DGS"


@dataclass(frozen=True)
class Cell:
    """What is written, and a note in smaller letters; `spread` is the figure behind it, with all its digits."""

    text: str
    note: str = ""
    spread: Spread = UNKNOWN


@dataclass(frozen=True)
class Line:
    """A row: its names, as many as the grid has headings for, and its cells; `published` where they are the paper's."""

    names: tuple[str, ...]
    cells: tuple[Cell, ...]
    published: bool = False


@dataclass(frozen=True)
class Grid:
    """`names` are the headings above the names of the lines, `headings` those above their cells."""

    caption: str
    names: tuple[str, ...]
    headings: tuple[str, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    @property
    def spans(self) -> tuple[int, ...]:
        """Over how many lines the first name of each line extends; 0 where a line above has done so."""
        if len(self.names) == 1:
            return (1,) * len(self.lines)
        groups = [len(list(group)) for _, group in groupby(self.lines, lambda line: line.names[0])]
        return tuple(span for size in groups for span in (size, *(0,) * (size - 1)))


def figure_cell(quantity: str, spread: Spread, note: str = "") -> Cell:
    """A figure as its quantity is written; with its standard deviation where there is one."""
    text = write_figure(quantity, spread.mean)
    if not math.isnan(spread.deviation):
        text += f" ± {write_figure(quantity, spread.deviation)}"
        note = ", ".join(part for part in (note, f"n = {spread.count}") if part)
    return Cell(text, note, spread)


def difference_cell(quantity: str, difference: float) -> Cell:
    """A difference with its sign."""
    return Cell(signed(quantity, difference), "", Spread(difference))


def signed(quantity: str, difference: float) -> str:
    """A difference with its sign, as its quantity is written; empty for NaN.

    >>> signed("psnr", 0.123), signed("psnr", -1.388), signed("psnr", -0.001)
    ('+0.12', '-1.39', '0.00')
    """
    if math.isnan(difference):
        return ""
    text = write_figure(quantity, difference)
    if float(text.replace("∞", "inf")) == 0:
        return text.removeprefix("-")
    return text if text.startswith("-") else f"+{text}"


def measured_cells(
    quantity: str, measured: Measured, reference: Measured | None, captures: Sequence[str]
) -> list[Cell]:
    """A cell for each capture, the average, and the difference to the reference; its notes are differences, too."""
    differences = measured.minus(reference) if reference is not None else Measured({})
    cells = [
        figure_cell(
            quantity,
            measured.by_capture.get(capture, UNKNOWN),
            signed(quantity, differences.on(capture)),
        )
        for capture in captures
    ]
    lacking = [capture for capture in captures if capture not in measured.by_capture]
    some = f"of {len(measured.by_capture)}" if lacking and measured.by_capture else ""
    whole = measured.average
    return [
        *cells,
        Cell(figure_cell(quantity, Spread(whole.mean, whole.deviation)).text, some, whole),
        difference_cell(quantity, differences.average.mean),
    ]


def published_cells(
    quantity: str, row: Row | None, reference: Row | None, captures: Sequence[str], tables: Published
) -> list[Cell]:
    """The same of a row of the paper: its captures that are among ours, and its average over all nine."""

    def cell(capture: str) -> Cell:
        value = tables.figure(row, capture)
        return figure_cell(quantity, Spread(value), signed(quantity, value - tables.figure(reference, capture)))

    return [
        *(cell(capture) for capture in captures),
        figure_cell(quantity, Spread(average(row))),
        difference_cell(quantity, average(row) - average(reference)),
    ]


def headings(captures: Iterable[str]) -> tuple[str, ...]:
    """Above `measured_cells`."""
    return (*map(capture_title, captures), AVERAGE, DIFFERENCE)


def without_empty_columns(grid: Grid) -> Grid:
    """The grid without columns in which nothing is written, and without lines of which nothing was measured."""
    lines = [line for line in grid.lines if any(cell.text not in ("", MISSING) for cell in line.cells)]
    kept = [
        index
        for index in range(len(grid.headings))
        if any(line.cells[index].text not in ("", MISSING) for line in lines)
    ]
    return Grid(
        grid.caption,
        grid.names,
        tuple(grid.headings[index] for index in kept),
        tuple(Line(line.names, tuple(line.cells[index] for index in kept), line.published) for line in lines),
        grid.notes,
    )


def write_csv(grids: Iterable[Grid]) -> str:
    """Every figure for other programs, a line each: the table, the names of its line, its column, all its digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", "line", "figures", "column", "value", "deviation", "n", "note"])
    for grid in grids:
        for line in grid.lines:
            for heading, cell in zip(grid.headings, line.cells, strict=True):
                if math.isnan(cell.spread.mean):
                    continue
                deviation = "" if math.isnan(cell.spread.deviation) else f"{cell.spread.deviation:.6g}"
                names = " · ".join(name for name in line.names if name not in (HERE, PAPER))
                source = PAPER if line.published else HERE
                count = cell.spread.count or ""
                writer.writerow(
                    [grid.caption, names, source, heading, f"{cell.spread.mean:.6g}", deviation, count, cell.note]
                )
    return text.getvalue()
