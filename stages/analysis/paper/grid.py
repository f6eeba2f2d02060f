"""Tables, in the form that the page, the Markdown file and the CSV file are made from."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from stages.analysis.page.figures import MISSING, write_figure
from stages.analysis.paper.measuring import UNKNOWN, Measured, Spread
from stages.analysis.paper.published import Published, Row, average
from stages.analysis.paper.runs import capture_title
from stages.imaging.quantities import QUANTITIES
from stages.scene.plurals import counted

HERE, PAPER = "here", "paper"
AVERAGE, DIFFERENCE = "Average", "vs. 3DGS"
NOT_MEASURED = "not measured"
SCALES = {"bytes": 1e-6, "s": 1e3}
"""Factors from units to those in which figures are written: MB and ms."""


@dataclass(frozen=True)
class Cell:
    """A text, a note in smaller letters, and in `spread` the figure behind them, unrounded."""

    text: str
    note: str = ""
    spread: Spread = UNKNOWN


@dataclass(frozen=True)
class Line:
    """A row: its names, one for each of the grid's `names`, and its cells; `published` if they are the paper's."""

    names: tuple[str, ...]
    cells: tuple[Cell, ...]
    published: bool = False


@dataclass(frozen=True)
class Grid:
    """A table: `names` are the headings above the names of the lines, `headings` those above their cells."""

    caption: str
    names: tuple[str, ...]
    headings: tuple[str, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    @property
    def spans(self) -> tuple[int, ...]:
        """How many lines the first name of each line spans; 0 if it is covered by that of a line above."""
        if len(self.names) == 1:
            return (1,) * len(self.lines)
        groups = [len(list(group)) for _, group in groupby(self.lines, lambda line: line.names[0])]
        return tuple(span for size in groups for span in (size, *(0,) * (size - 1)))

    @property
    def worded(self) -> tuple[bool, ...]:
        """Which columns of cells contain words and no figures; these are aligned left."""
        columns = [[line.cells[column].text[:1] for line in self.lines] for column in range(len(self.headings))]
        return tuple(
            any(map(str.isalpha, column)) and all(first.isalpha() or first in ("", MISSING) for first in column)
            for column in columns
        )


def figure_cell(quantity: str, spread: Spread, note: str = "") -> Cell:
    """A figure as its quantity is written, with its standard deviation if that is known and does not round to zero."""
    text = write_figure(quantity, spread.mean)
    if not math.isnan(spread.deviation):
        deviation = write_figure(quantity, spread.deviation)
        text += f" ± {deviation}" if deviation != write_figure(quantity, 0.0) else ""
        note = ", ".join(part for part in (note, f"n = {spread.count}") if part)
    return Cell(text, note, as_written(quantity, spread))


def as_written(quantity: str, spread: Spread) -> Spread:
    """A figure in the unit in which it is written.

    >>> as_written("seconds_per_frame", Spread(0.25, 0.125, 3))
    Spread(mean=250.0, deviation=125.0, count=3, worth=1.0)
    """
    scale = SCALES.get(QUANTITIES[quantity].unit, 1)
    return replace(spread, mean=spread.mean * scale, deviation=spread.deviation * scale)


def published_cell(quantity: str, value: float, note: str = "") -> Cell:
    """A figure of the paper with the paper's digits; `MISSING` for NaN.

    >>> published_cell("psnr", 27.205).text, published_cell("seconds_per_frame", 0.0222).text
    ('27.205', '22.2')
    """
    if math.isnan(value):
        return Cell(MISSING)
    text = write_figure(quantity, value) if QUANTITIES[quantity].unit == "s" else f"{value:.3f}"
    return Cell(text, note, as_written(quantity, Spread(value)))


def published_difference(difference: float) -> str:
    """A difference between figures of the paper, with the paper's digits; empty for NaN."""
    return "" if math.isnan(difference) else f"{difference:+.3f}"


def difference_cell(quantity: str, difference: float) -> Cell:
    """A difference with its sign."""
    return Cell(signed(quantity, difference), "", as_written(quantity, Spread(difference)))


def signed(quantity: str, difference: float) -> str:
    """A difference with its sign, as its quantity is written; empty for NaN.

    >>> signed("psnr", 0.123), signed("psnr", -1.388), signed("psnr", -0.001)
    ('+0.12', '-1.39', '0.00')
    """
    if math.isnan(difference):
        return ""
    text = write_figure(quantity, difference)
    if text.removeprefix("-") == write_figure(quantity, 0.0):
        return text.removeprefix("-")
    return text if text.startswith("-") else f"+{text}"


def average_cell(quantity: str, measured: Measured, captures: Collection[str], note: str = "") -> Cell:
    """The average, with its deviation if known; the note says if it is over fewer captures than there are."""
    return figure_cell(quantity, measured.average, ", ".join(filter(None, (note, some_of(measured, captures)))))


def size_cell(quantity: str, measured: Measured, captures: Collection[str]) -> Cell:
    """The average of what seeds hardly change, without its deviation; the note is that of `average_cell`."""
    return figure_cell(quantity, Spread(measured.average.mean), some_of(measured, captures))


def some_of(measured: Measured, captures: Collection[str]) -> str:
    """The number of captures that a figure is over, if that is not all of them, nor none; else empty.

    >>> some_of(Measured({"fox": Spread(1.0)}), ["fox", "kitchen"])
    'on 1 capture'
    """
    lacking = [capture for capture in captures if capture not in measured.by_capture]
    return f"on {counted(len(measured.by_capture), 'capture')}" if lacking and measured.by_capture else ""


def measured_cells(
    quantity: str, measured: Measured, reference: Measured | None, captures: Sequence[str], expected: bool = False
) -> list[Cell]:
    """A cell for each capture, the average, and its difference from the reference; notes have differences, too.

    If a figure was `expected` but measured on no capture, the average's cell says so.
    """
    if expected and not measured.by_capture:
        return [*(Cell(MISSING) for _ in captures), Cell(NOT_MEASURED), Cell("")]
    differences = measured.minus(reference) if reference is not None else Measured({})
    cells = [
        figure_cell(
            quantity,
            measured.by_capture.get(capture, UNKNOWN),
            signed(quantity, differences.on(capture)),
        )
        for capture in captures
    ]
    whole = measured.average
    return [
        *cells,
        Cell(figure_cell(quantity, whole).text, some_of(measured, captures), as_written(quantity, whole)),
        difference_cell(quantity, differences.average.mean),
    ]


def published_cells(
    quantity: str, row: Row | None, reference: Row | None, captures: Sequence[str], tables: Published
) -> list[Cell]:
    """`measured_cells` of a row of the paper: its figures for our captures, and its average over all nine."""

    difference = average(row) - average(reference)

    def cell(capture: str) -> Cell:
        value = tables.figure(row, capture)
        return published_cell(quantity, value, published_difference(value - tables.figure(reference, capture)))

    return [
        *(cell(capture) for capture in captures),
        published_cell(quantity, average(row)),
        Cell(published_difference(difference), "", Spread(difference)),
    ]


def headings(captures: Iterable[str]) -> tuple[str, ...]:
    """The headings above `measured_cells`."""
    return (*map(capture_title, captures), AVERAGE, DIFFERENCE)


def without_empty_columns(grid: Grid) -> Grid:
    """The grid without columns that have no text, and without lines in which nothing was measured."""
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
    """Every figure as CSV, one per line, with six significant digits, for other programs."""
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
