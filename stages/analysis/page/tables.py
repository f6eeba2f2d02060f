"""Tables of mean figures: a line for each method and message, columns by split, legality and coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from stages.analysis.page.figures import label, write_figure
from stages.analysis.page.material import Material
from stages.imaging.metric_table import QUANTITIES, MetricRow, mean_value

PICTURE_QUANTITIES = ("psnr", "ssim", "lpips_vgg", "lpips_alex")
COVERED_QUANTITIES = ("psnr_covered", "ssim_covered", "psnr_constant")
WHOLE_QUANTITIES = ("container_bytes", "gaussians", "seconds_per_frame")
LEAKAGE_QUANTITIES = ("residual_correlation", "residual_correlation_others")


@dataclass(frozen=True)
class Column:
    """The mean of a quantity over the views of a split, or over the legal ones among them."""

    quantity: str
    split: str | None = None
    group: str = ""
    only_legal: bool = False


COVER_COLUMNS = (
    *(Column(quantity, "test", "Test views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, "train", "Training views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, None, "Scene") for quantity in WHOLE_QUANTITIES),
)
MESSAGE_COLUMNS = (
    *(Column(quantity, "test", "Test views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, "test", "Test views, covered pixels") for quantity in COVERED_QUANTITIES),
    Column("legal", "test", "Legal test views"),
    *(Column(quantity, "test", "Legal test views", only_legal=True) for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, "train", "Training views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, "train", "Training views, covered pixels") for quantity in COVERED_QUANTITIES),
    *(Column(quantity, "test", "Trace in the cover") for quantity in LEAKAGE_QUANTITIES),
)


@dataclass(frozen=True)
class Cell:
    """A figure as written, and whether it is the best of its column."""

    text: str
    best: bool


@dataclass(frozen=True)
class Table:
    """``groups`` are the headings above the columns, each with how many it spans; a line is its name and its cells."""

    caption: str
    groups: tuple[tuple[str, int], ...]
    headings: tuple[str, ...]
    lines: tuple[tuple[str, tuple[Cell, ...]], ...]
    definitions: tuple[tuple[str, str], ...]

    @property
    def starts(self) -> tuple[int, ...]:
        """The columns with which a group begins."""
        spans = [span for _, span in self.groups]
        return tuple(sum(spans[:index]) for index in range(len(spans)))


@dataclass(frozen=True)
class _Line:
    name: str
    rows: tuple[MetricRow, ...]


def cover_table(material: Material) -> Table | None:
    """A line for each method; None without any figure."""
    lines = [_Line(method, rows_about(material.scores, method)) for method in material.methods]
    return _table("Cover" if material.messages else "Scene", lines, COVER_COLUMNS)


def message_table(material: Material) -> Table | None:
    """For each message a line for each method; None without any."""
    lines = [
        _Line(f"{message} · {method}", rows_about(material.scores, method, message))
        for message in material.messages
        for method in material.methods
    ]
    return _table("Messages", [line for line in lines if line.rows], MESSAGE_COLUMNS)


def rows_about(rows: Sequence[MetricRow], method: str, message: str | None = None) -> tuple[MetricRow, ...]:
    """The rows of one method about one message, or about the cover."""
    return tuple(row for row in rows if row.method == method and row.message == message)


def mean_of(rows: Sequence[MetricRow], column: Column) -> float:
    """The column's figure for rows of one line; NaN where nothing was measured."""
    legal = {row.view for row in rows if row.quantity == "legal" and row.value > 0}
    return mean_value(
        [row for row in _in_column(rows, column) if not column.only_legal or row.view in legal],
    )


def _in_column(rows: Sequence[MetricRow], column: Column) -> list[MetricRow]:
    return [row for row in rows if row.quantity == column.quantity and row.split == column.split]


def _table(caption: str, lines: Sequence[_Line], columns: Sequence[Column]) -> Table | None:
    values = {column: [mean_of(line.rows, column) for line in lines] for column in columns}
    columns = [column for column in columns if not all(map(math.isnan, values[column]))]
    if not columns:
        return None
    cells = [_cells(column, lines, values[column]) for column in columns]
    quantities = dict.fromkeys(column.quantity for column in columns)
    return Table(
        caption,
        tuple((group, len(list(members))) for group, members in groupby(columns, lambda column: column.group)),
        tuple(label(column.quantity) for column in columns),
        tuple((line.name, tuple(column[index] for column in cells)) for index, line in enumerate(lines)),
        tuple((QUANTITIES[name].label, QUANTITIES[name].definition) for name in quantities),
    )


def _cells(column: Column, lines: Sequence[_Line], values: Sequence[float]) -> list[Cell]:
    if column.quantity == "legal":
        return [Cell(_count(_in_column(line.rows, column)), False) for line in lines]
    texts = [write_figure(column.quantity, value) for value in values]
    best = _best(QUANTITIES[column.quantity].better, values)
    return [Cell(text, value == best) for text, value in zip(texts, values, strict=True)]


def _count(flags: Sequence[MetricRow]) -> str:
    return f"{round(sum(row.value for row in flags))} of {len(flags)}" if flags else write_figure("legal", math.nan)


def _best(better: str, values: Sequence[float]) -> float:
    """NaN, which equals nothing, where there is nothing to compare."""
    measured = [value for value in values if not math.isnan(value)]
    if len(set(measured)) < 2 or not better:
        return math.nan
    return max(measured) if better == "higher" else min(measured)
