"""`foreach` and `matrix`: the rows of values that a stage of the file runs for, and the name of each row.

foreach: {scene: [reef, library], seed: [1, 2]}                 columns, paired item by item: two rows
foreach: [{scene: reef, seed: 1}, {scene: library, seed: 2}]    the same, row by row
foreach: pairs.csv                                              the same, from a file: see `table`
matrix:  {rate: [0.1, 0.2], size: [8, 16, 32]}                  every combination: six rows
matrix:  {rate: [0.1, 0.2], size: [8, 16], exclude: [{rate: 0.2, size: 16}], include: [{rate: 0.4, size: 8}]}
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from pipeline.canonical import Json, canonical_json, digest_of
from pipeline.errors import Place, nearest
from pipeline.store.external import from_home
from pipeline.workflow.located import Located, Problems
from pipeline.workflow.table import COLUMN, COLUMN_WORDS, read_table

EXAMPLE = "{cover: [a, b], message: [c, d]}, a list of rows [{cover: a, message: c}], or a CSV file"
MOST_ROWS = 100_000
LISTED = 4  # duplicate rows that are reported one by one
LONGEST_LABEL = 40  # bytes in the label of one value: stage names become file names
LONGEST_NAME = 120  # bytes in the label of a row
PLAIN_LABEL = re.compile(r"(?!/)[\w.+/-]+")  # no path from the root


@dataclass(frozen=True)
class Rows:
    """One or more rows, no two of them equal, each with a value for every column."""

    columns: tuple[str, ...]
    values: tuple[Mapping[str, Located], ...]
    _labels: dict[tuple[str, ...], list[str]] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def plain(self) -> tuple[Mapping[str, Json], ...]:
        """The values as plain JSON data, without places."""
        return tuple({column: row[column].plain for column in self.columns} for row in self.values)

    @cached_property
    def identity(self) -> str:
        """A digest, equal for the same rows in the same order: stages with equal digests are paired row by row."""
        return digest_of(self.plain, "the rows")

    def scope(self, index: int) -> dict[str, Located]:
        """The values that `${item.…}` stands for in a row, by name."""
        return {f"item.{column}": value for column, value in self.values[index].items()}

    def identities(self, columns: Sequence[str]) -> list[bytes]:
        """For each row, a spelling of its values in `columns`, equal only for equal values.

        Equal texts with different bases count as different: as paths, they lead to different files.
        """
        spelt = [canonical_json([row[column] for column in columns]) for row in self.plain]
        bases = [[str(text.base) for column in columns for text in row[column].texts()] for row in self.values]
        first = dict(zip(reversed(spelt), reversed(bases), strict=True))
        elsewhere = {spelling for spelling, where in zip(spelt, bases, strict=True) if where != first[spelling]}
        return [
            spelling + canonical_json(where) if spelling in elsewhere else spelling
            for spelling, where in zip(spelt, bases, strict=True)
        ]

    def labels(self, columns: Sequence[str]) -> list[str]:
        """The name of each row, computed once per choice of columns: see `_named`."""
        if tuple(columns) not in self._labels:
            self._labels[tuple(columns)] = self._named(columns)
        return self._labels[tuple(columns)]

    def _named(self, columns: Sequence[str]) -> list[str]:
        """For each row, a short name made from its values in `columns`; rows with equal values share one.

        It depends on nothing else, so a row keeps its name when others are added or removed. Only if a value has no
        label (`_value_label`), or if other values have the same one, does the name contain a row number. It is empty if
        there are no columns.
        """
        identities = self.identities(columns)
        first = {identity: index for index, identity in reversed(list(enumerate(identities)))}
        labels = {identity: _label([self.plain[index][c] for c in columns]) for identity, index in first.items()}
        counts = Counter(labels.values())
        unclear = {identity for identity, label in labels.items() if label is None or counts[label] > 1}
        return [
            f"{labels[identity] or ''}#{first[identity] + 1}" if identity in unclear else str(labels[identity])
            for identity in identities
        ]


def expand(key: str, located: Located, problems: Problems, wanted: Sequence[str] = ()) -> Rows | None:
    """The rows of a `foreach` or a `matrix`; None, with every reason added to `problems`, if anything is wrong.

    `wanted` are the columns that a table, or rows given one by one, must have.
    """
    before = len(problems)
    values = _combinations(located, problems) if key == "matrix" else _foreach(located, problems, wanted)
    if values is None or len(problems) > before:
        return None
    rows = Rows(tuple(values[0]), tuple(values))
    _report_strange_values(rows, problems)
    if len(problems) == before:
        _report_equal_rows(rows, problems)
    return rows if len(problems) == before else None


def _foreach(located: Located, problems: Problems, wanted: Sequence[str]) -> Sequence[Mapping[str, Located]] | None:
    if isinstance(located.value, str):
        table = read_table(located.base / from_home(located.value), located.place, problems, wanted)
        return None if table is None else _listed("foreach", table, problems)
    if isinstance(located.value, tuple) and located.value:
        return _listed("foreach", located.value, problems, wanted)
    if isinstance(located.value, Mapping) and located.value:
        return _walked_together(located, problems)
    problems.add(located.place, f"foreach is {located.found}; expected lists such as {EXAMPLE}")
    return None


def _walked_together(located: Located, problems: Problems) -> list[dict[str, Located]] | None:
    columns = _columns("foreach", located, problems)
    if columns is None:
        return None
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name}: {length}" for name, length in lengths.items())
        problems.add(located.place, f"the lists of a foreach must have the same length; found {found}")
        return None
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _combinations(located: Located, problems: Problems) -> list[Mapping[str, Located]] | None:
    """Every combination, the first list varying slowest, without the excluded rows and with the included ones."""
    columns = _columns("matrix", located, problems, besides=("exclude", "include"))
    if columns is None or not isinstance(located.value, Mapping):
        return None
    number = math.prod(len(column) for column in columns.values())
    if number > MOST_ROWS:
        problems.add(located.place, f"this matrix has {number:,} rows; at most {MOST_ROWS:,} are allowed")
        return None
    rows: list[Mapping[str, Located]] = [
        dict(zip(columns, row, strict=True)) for row in itertools.product(*columns.values())
    ]
    for place, excluded in _extra_rows("exclude", located, columns, problems):
        kept = [row for row in rows if any(row[name].plain != value.plain for name, value in excluded.items())]
        if len(kept) == len(rows):
            problems.add(place, "this excludes no row of the matrix")
        rows = kept
    for place, included in _extra_rows("include", located, columns, problems):
        lacking = [name for name in columns if name not in included]
        if lacking:
            problems.add(place, f"this row has no {', '.join(lacking)}; expected all of {', '.join(columns)}")
        rows.append(included)
    if not rows:
        problems.add(located.place, "this matrix has no rows: all are excluded")
        return None
    return rows


def _columns(
    key: str, located: Located, problems: Problems, besides: Sequence[str] = ()
) -> dict[str, tuple[Located, ...]] | None:
    """The lists of a mapping by name, except the entries `besides`."""
    if not isinstance(located.value, Mapping) or not located.value.keys() - set(besides):
        example = "{rate: [0.1, 0.2], size: [8, 16]}"
        problems.add(located.place, f"{key} is {located.found}; expected names, each with a list: {example}")
        return None
    before = len(problems)
    columns: dict[str, tuple[Located, ...]] = {}
    for name, column in located.value.items():
        if name in besides:
            continue
        _check_name(name, located.keys.get(name, column.place), problems)
        if not isinstance(column.value, tuple) or not column.value:
            problems.add(column.place, f"{key}.{name} is {column.found}; expected a list with at least one item")
        else:
            columns[name] = column.value
    return columns if len(problems) == before else None


def _listed(
    key: str, rows: Sequence[Located], problems: Problems, wanted: Sequence[str] = ()
) -> list[Mapping[str, Located]]:
    """Rows given one by one; all must have the columns of the first row, and the `wanted` ones."""
    listed: list[Mapping[str, Located]] = []
    for row in rows:
        if not isinstance(row.value, Mapping) or not row.value:
            expected = "names, each with a value: {cover: a, message: b}"
            problems.add(row.place, f"a row of {key} is {row.found}; expected {expected}")
            continue
        names = tuple(listed[0] if listed else row.value)
        for name in row.value:
            if not listed:
                _check_name(name, row.keys.get(name, row.place), problems)
            elif name not in names:
                message = f"this row has {name!r}, which the first row lacks; it has {', '.join(names)}"
                problems.add(row.keys.get(name, row.place), f"{message}{nearest(name, names)}")
        expected_names = dict.fromkeys([*names, *wanted])
        lacking = [name for name in expected_names if name not in row.value]
        if lacking:
            # What the first row has besides what is wanted may be a wanted name misspelt.
            all_of = wanted if set(lacking) <= set(wanted) else tuple(expected_names)
            problems.add(row.place, f"this row has no {', '.join(lacking)}; expected all of {', '.join(all_of)}")
        listed.append(row.value)
    return listed


def _extra_rows(
    key: str, matrix: Located, columns: Iterable[str], problems: Problems
) -> Iterable[tuple[Place, Mapping[str, Located]]]:
    """The rows of `exclude` or `include`; those with unknown columns are reported and skipped."""
    if not isinstance(matrix.value, Mapping) or key not in matrix.value:
        return
    rows, names = matrix.value[key], list(columns)
    if not isinstance(rows.value, tuple):
        problems.add(rows.place, f"matrix.{key} is {rows.found}; expected a list of rows: [{{{names[0]}: …}}]")
        return
    for row in rows.value:
        if not isinstance(row.value, Mapping) or not row.value:
            problems.add(row.place, f"a row of {key} is {row.found}; expected names with values: {{{names[0]}: …}}")
            continue
        unknown = [name for name in row.value if name not in names]
        for name in unknown:
            message = f"the matrix has no {name!r}; it has {', '.join(names)}{nearest(name, names)}"
            problems.add(row.keys.get(name, row.place), message)
        if not unknown:
            yield row.place, row.value


def _check_name(name: str, place: Place, problems: Problems) -> None:
    if not COLUMN.fullmatch(name):
        problems.add(place, f"{name!r} cannot name a column; expected {COLUMN_WORDS}")


def _report_strange_values(rows: Rows, problems: Problems) -> None:
    for row in rows.values:
        for name, value in row.items():
            try:
                canonical_json(value.plain, name)
            except ValueError as error:
                problems.add(value.place, str(error))


def _report_equal_rows(rows: Rows, problems: Problems) -> None:
    seen: dict[bytes, int] = {}
    identities = rows.identities(rows.columns)
    again = [(seen[each], row) for row, each in enumerate(identities) if seen.setdefault(each, row) < row]
    for number, pair in enumerate(again[:LISTED], start=1):
        first, second = (next(iter(rows.values[row].values())).place for row in pair)
        more = f" (and {len(again) - LISTED} more such rows)" if number == LISTED < len(again) else ""
        problems.add(second, f"this row appears twice; the first is at {first}{more}")


def _label(values: Sequence[Json]) -> str | None:
    """The label of a row, made from its own values; None if they cannot name it."""
    parts = [_value_label(value) for value in values]
    label = ",".join(part for part in parts if part)
    if None in parts or (values and not label):
        return None
    return label if len(label.encode()) <= LONGEST_NAME else f"{label[:LONGEST_LABEL]}-{digest_of(values)[:8]}"


def _value_label(value: Json) -> str | None:
    """The label of a value, as part of a file name; None for an empty text, and for lists and mappings inside others.

    Those by themselves have the labels of what is in them. Of a path from the root only the last part is used, since
    pages show labels and should not show this machine's folders. If anything had to be dropped, a few digits of the
    value's hash are appended.

    >>> _value_label(0.25), _value_label("photos/fox"), _value_label("my photos/living room")
    ('0.25', 'photos:fox', 'living-room-08323b1d')
    >>> _value_label("/photos/fox")
    'fox-901c26c1'
    >>> _value_label({"levels": 2, "rate": 0.1}), _value_label(["reef", "fox"]), _value_label({}), _value_label([[]])
    ('levels-2-rate-0.1', 'reef-fox', '', None)
    """
    if isinstance(value, list | dict):
        inner = value if isinstance(value, list) else [part for pair in value.items() for part in pair]
        labels = [None if isinstance(part, list | dict) else _value_label(part) for part in inner]
        return None if None in labels else "-".join(str(part) for part in labels)
    if value == "":
        return None
    text = value if isinstance(value, str) else canonical_json(value).decode()
    if PLAIN_LABEL.fullmatch(text) and len(text.encode()) <= LONGEST_LABEL:
        return text.replace("/", ":")
    last = re.sub(r"[^\w.+]+", "-", text.rstrip("/").rpartition("/")[2]).strip("-")[:LONGEST_LABEL]
    while len(last.encode()) > LONGEST_LABEL - 9:
        last = last[:-1]
    return f"{last}-{digest_of(text)[:8]}"
