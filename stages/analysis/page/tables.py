"""Tables of mean figures: a line for each method and message, columns by split, legality and coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from stages.analysis.page.figures import WORDING, label, write_figure
from stages.analysis.page.found import Found
from stages.analysis.page.headings import first_columns
from stages.analysis.page.material import Material
from stages.imaging.metric_table import MetricRow, mean_value
from stages.imaging.quantities import QUANTITIES

PICTURE_QUANTITIES = ("psnr", "ssim", "lpips_vgg", "lpips_alex")
COVERED_QUANTITIES = {"psnr_covered": "PSNR (dB)", "ssim_covered": "SSIM", "psnr_constant": "One colour (dB)"}
WHOLE_QUANTITIES = ("container_bytes", "gaussians", "seconds_per_frame", "seconds_per_feature_map")
LEAKAGE_QUANTITIES = {"residual_correlation": "Its own view", "residual_correlation_others": "Other views"}


@dataclass(frozen=True)
class Column:
    """The mean of a quantity over a split's views, or its legal ones; `heading` defaults to the quantity's label."""

    quantity: str
    split: str | None = None
    group: str = ""
    heading: str = ""
    only_legal: bool = False


COVER_COLUMNS = (
    *(Column(quantity, "test", "Test views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, "train", "Training views") for quantity in PICTURE_QUANTITIES),
    *(Column(quantity, None, "Scene") for quantity in WHOLE_QUANTITIES),
)
LEGAL_COLUMNS = (
    Column("legal", "test", "Legal test views", "Views"),
    *(Column(quantity, "test", "Legal test views", only_legal=True) for quantity in PICTURE_QUANTITIES),
)
LEAKAGE_COLUMNS = tuple(
    Column(quantity, "test", "Correlation of the cover's error with the message", heading)
    for quantity, heading in LEAKAGE_QUANTITIES.items()
)
FOUND_GROUPS = (("Changes, now undone", 5), ("Gaussians", 4))
FOUND_HEADINGS = (
    *("Mirrored", "Rotation (degrees)", "Shift", "Scale", "Features"),
    *("Published", "Found", "Matched (%)", "Found again (%)"),
)
FOUND_WORDING = (
    ("Shift", "How far the centre was moved, in units of the published scene."),
    ("Features", "How much features in [0, 1] were changed back, root mean square."),
    ("Matched", "How many of the found Gaussians are published ones, by position once moved back, or by shape."),
    ("Found again", "How many of the published Gaussians are in the found container."),
)


def message_columns(split: str, views: str) -> tuple[Column, ...]:
    """Columns for messages on the views of one split; ``views`` is the heading above those of whole pictures."""
    return (
        *(Column(quantity, split, views) for quantity in PICTURE_QUANTITIES),
        *(Column(quantity, split, "Covered pixels", heading) for quantity, heading in COVERED_QUANTITIES.items()),
    )


@dataclass(frozen=True)
class Cell:
    """A formatted figure, and whether it is marked as the best for its message."""

    text: str
    best: bool


@dataclass(frozen=True)
class Table:
    """A table. ``groups`` are headings, each with the number of columns it spans; a line is its name and its cells."""

    caption: str
    groups: tuple[tuple[str, int], ...]
    headings: tuple[str, ...]
    lines: tuple[tuple[str, tuple[Cell, ...]], ...]
    definitions: tuple[tuple[str, str], ...]

    @property
    def starts(self) -> tuple[int, ...]:
        """The first column of each group."""
        return first_columns(self.groups)


@dataclass(frozen=True)
class _Line:
    name: str
    message: str | None
    rows: tuple[MetricRow, ...]


def tables_of(material: Material) -> tuple[Table, ...]:
    """All tables with at least one figure; they have a line for each method, or for each message and method."""
    methods, messages = material.methods, material.messages
    cover = [_Line(method, None, rows_about(material.scores, method)) for method in methods]
    hidden = [
        _Line(f"{message} · {method}", message, rows_about(material.scores, method, message))
        for message in messages
        for method in methods
    ]
    tables = (
        _table("Cover" if messages else "Scene", cover, COVER_COLUMNS),
        _table("Messages on test views", hidden, (*message_columns("test", "Whole pictures"), *LEGAL_COLUMNS)),
        _table("Messages on training views", hidden, message_columns("train", "Whole pictures")),
        _table("Traces of the messages in the cover, test views", hidden, LEAKAGE_COLUMNS),
    )
    return (*_found_tables(material.found), *(table for table in tables if table is not None))


def _found_tables(found: Sequence[Found]) -> tuple[Table, ...]:
    """A table with a line for each found container; no table if there is none."""
    lines = tuple(
        ("Yours" if each.is_yours else "Perhaps yours", tuple(Cell(text, False) for text in _written(each)))
        for each in found
    )
    return (Table("What was found", FOUND_GROUPS, FOUND_HEADINGS, lines, FOUND_WORDING),) if lines else ()


def _written(found: Found) -> tuple[str, ...]:
    return (
        "yes" if found.mirrored else "no",
        *(f"{found.degrees:.1f}", f"{found.shift:.3f}", f"{found.scale:.3f}", f"{found.feature_change:.3f}"),
        *(f"{found.gaussians_published:,.0f}", f"{found.gaussians_found:,.0f}"),
        *(f"{100 * found.matched:.1f}", f"{100 * found.found_again:.1f}"),
    )


def rows_about(rows: Sequence[MetricRow], method: str, message: str | None = None) -> tuple[MetricRow, ...]:
    """The rows of one method about one message, or about the cover if the message is None."""
    return tuple(row for row in rows if row.method == method and row.message == message)


def mean_of(rows: Sequence[MetricRow], column: Column) -> float:
    """The column's figure for the rows of one line; NaN if nothing was measured."""
    legal = {row.view for row in rows if row.quantity == "legal" and row.value > 0}
    return mean_value([row for row in _in_column(rows, column) if not column.only_legal or row.view in legal])


def _in_column(rows: Sequence[MetricRow], column: Column) -> list[MetricRow]:
    return [row for row in rows if row.quantity == column.quantity and row.split == column.split]


def _table(caption: str, lines: Sequence[_Line], columns: Sequence[Column]) -> Table | None:
    """The table of the lines and columns that have a figure; None if there are none."""
    lines = [line for line in lines if any(_measured(line, column) for column in columns)]
    columns = [column for column in columns if any(_measured(line, column) for line in lines)]
    if not columns:
        return None
    cells = [_cells(column, lines) for column in columns]
    quantities = dict.fromkeys(column.quantity for column in columns)
    return Table(
        caption,
        tuple((group, len(list(members))) for group, members in groupby(columns, lambda column: column.group)),
        tuple(column.heading or label(column.quantity) for column in columns),
        tuple((line.name, tuple(column[index] for column in cells)) for index, line in enumerate(lines)),
        tuple(WORDING[name] for name in quantities),
    )


def _measured(line: _Line, column: Column) -> bool:
    return not math.isnan(mean_of(line.rows, column))


def _cells(column: Column, lines: Sequence[_Line]) -> list[Cell]:
    if column.quantity == "legal":
        return [Cell(_count(_in_column(line.rows, column)), False) for line in lines]
    values = [mean_of(line.rows, column) for line in lines]
    return [
        Cell(write_figure(column.quantity, value), _is_best(column, line, lines))
        for line, value in zip(lines, values, strict=True)
    ]


def _is_best(column: Column, line: _Line, lines: Sequence[_Line]) -> bool:
    """Whether, among the formatted figures for the same message, none is better than this line's and some are worse."""
    better = QUANTITIES[column.quantity].better
    own = mean_of(line.rows, column)
    rivals = [mean_of(each.rows, column) for each in lines if each.message == line.message and _measured(each, column)]
    texts = {write_figure(column.quantity, value) for value in rivals}
    if math.isnan(own) or not better or len(texts) < 2:
        return False
    best = max(rivals) if better == "higher" else min(rivals)
    return write_figure(column.quantity, own) == write_figure(column.quantity, best)


def _count(flags: Sequence[MetricRow]) -> str:
    return f"{round(sum(row.value for row in flags))} of {len(flags)}" if flags else write_figure("legal", math.nan)
