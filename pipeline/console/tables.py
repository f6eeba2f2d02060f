"""Tables as text: columns as wide as they need to be, and long tables in short."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from pipeline.canonical import Json
from pipeline.plain_text import LONGEST_LINE, in_a_line

QUANTITY, VALUE = "quantity", "value"  # columns of tables with one figure per row
NOT_IN_JSON = ("inf", "-inf", "nan")  # numbers that JSON lacks, as they are written in tables
Row = Mapping[str, Json]


def table(rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> list[str]:
    """Lines with the columns of `rows` side by side, those with the numbers `right` flush right; empty without rows.

    A column is at most `LONGEST_LINE` wide: a longer cell moves the rest of its own row only.

    >>> table([["name", "size"], ["cover", "12"]], right=[1])
    ['name   size', 'cover    12']
    """
    widths = [min(max(map(len, column)), LONGEST_LINE) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if number in right else cell.ljust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def indented(lines: Iterable[str]) -> list[str]:
    """Lines that stand under a title."""
    return [f"  {line}" for line in lines]


def rows_table(rows: Sequence[Row], spelled: Callable[[str], str] = in_a_line) -> list[str]:
    """Lines that show rows, with those columns that hold anything. `spelled` makes a text safe for a terminal."""
    names = dict.fromkeys(name for row in rows for name in row)
    columns = [name for name in names if any(row.get(name) not in (None, "") for row in rows)]
    numbers = [i for i, name in enumerate(columns) if not any(isinstance(row.get(name), str) for row in rows)]
    if not columns:
        return []
    cells = ([_cell(row.get(name), spelled) for name in columns] for row in rows)
    return table([[spelled(name) for name in columns], *cells], numbers)


def in_short(rows: Sequence[Row], most: int) -> tuple[list[Row], str | None]:
    """About `most` rows at most, and how they were arrived at in words, None if they are all.

    If each row is one figure (a `quantity` and its `value`), rows that differ only in numbers, such as the iteration,
    are merged into one. If that leaves too many, so are rows that differ only in the text column with the most values,
    such as the picture's name, and so on. Of other tables, the first and last rows are kept.
    """
    if len(rows) <= most:
        return list(rows), None
    if not all(isinstance(row.get(QUANTITY), str) and VALUE in row for row in rows):
        half = most // 2
        return [
            *rows[: most - half],
            *rows[len(rows) - half :],
        ], f"first {most - half} and last {half} of {len(rows)} rows"
    columns = [name for name in _texts(rows) if name != QUANTITY]
    left_out: list[str] = []
    groups = _groups(rows, [QUANTITY, *columns])
    while len(groups) > most and columns:
        various = max(columns, key=lambda name: len({str(row.get(name)) for row in rows}))
        columns.remove(various)
        left_out.append(various)
        groups = _groups(rows, [QUANTITY, *columns])
    over = f" over {' and '.join(left_out)}" if left_out else ""
    return [_figures(group, [QUANTITY, *columns]) for group in groups], f"{len(rows)} rows, summarised{over}"


def _groups(rows: Sequence[Row], columns: Sequence[str]) -> list[list[Row]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row.get(name)) for name in columns), []).append(row)
    return list(groups.values())


def _figures(group: Sequence[Row], columns: Sequence[str]) -> Row:
    """One row that summarises a group: its number of rows, and mean, least, greatest and last value.

    The mean is of finite values; `not in mean` says of how many rows it is not. The others are of all values but NaN.
    """
    values = [value for row in group if (value := _figure(row[VALUE])) is not None and not math.isnan(value)]
    finite = [value for value in values if math.isfinite(value)]
    figures: dict[str, Json] = {name: group[0].get(name) for name in columns}
    figures["rows"] = len(group)
    if finite:
        figures["mean"] = sum(finite) / len(finite)
    if values:
        figures |= {"least": min(values), "greatest": max(values)}
        if any(_is_number(value) for name, value in group[0].items() if name != VALUE):
            figures["last"] = values[-1]
        if len(finite) < len(group):
            figures["not in mean"] = len(group) - len(finite)
    return figures


def _texts(rows: Sequence[Row]) -> list[str]:
    """Columns that hold a text in any row; a figure that is infinite or NaN is none."""
    return list(
        dict.fromkeys(
            name
            for row in rows
            for name, value in row.items()
            if isinstance(value, str) and not (name == VALUE and value in NOT_IN_JSON)
        )
    )


def _figure(value: Json) -> float | None:
    """The number that a value is; None if it is something else."""
    if isinstance(value, str):
        return float(value) if value in NOT_IN_JSON else None
    return _as_float(value) if isinstance(value, int | float) and _is_number(value) else None


def _is_number(value: Json) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _as_float(value: float) -> float:
    """`value` as a float; infinite for an integer beyond what a float can hold."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _cell(value: Json, spelled: Callable[[str], str]) -> str:
    return "" if value is None else number_words(value) if isinstance(value, float) else spelled(str(value))


def number_words(value: float) -> str:
    """A number as a person reads it: whole numbers below 1e9 in full, others to four digits.
    >>> number_words(0.0), number_words(31000.0), number_words(16.9656), number_words(1.6e-06), number_words(-math.inf)
    ('0', '31000', '16.97', '1.6e-06', '-inf')
    """
    return f"{value:.0f}" if abs(value) < 1e9 and value == int(value) else f"{value:.4g}"
