"""Tables in CSV files, in which every cell knows its place.

    cover,message
    photos/kitchen,photos/fox
    photos/garden,"photos/2024"

The first row names the columns; `Cover` names `cover` if only that is wanted. A cell is a number, `true`, `false` or
`null` if spelled as in JSON, null if empty, and otherwise a text; in quotes it is always a text. A path is always a
text, quoted or not. Cells are separated by commas or, if those of the first row are, by semicolons or tabs, as
spreadsheets write them in many countries. Blanks around cells, empty lines and empty last columns are ignored.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import Place
from pipeline.plain_text import in_a_line
from pipeline.workflow.located import Located, Problems, Scalar

DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab"}
CELLS = {
    delimiter: re.compile(
        rf'[{blanks}]*(?:"(?P<quoted>[^"]*(?:""[^"]*)*)"[{blanks}]*|(?P<bare>[^{delimiter}\r\n]*))(?=[{delimiter}\r\n]|\Z)'
    )
    for delimiter, blanks in ((",", " \t"), (";", " \t"), ("\t", " "))
}
LINE_END = re.compile("\r\n|\r|\n")
JSON_SCALAR = re.compile(r"true|false|null|-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?")
UNPRINTABLE = re.compile(r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]")
LONGEST_NUMBER = 300  # characters; anything longer is a text, since Python reads no numbers of thousands of digits
LONGEST_HEADER = 200  # characters of a first row that an error shows
COLUMN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
COLUMN_WORDS = "letters, digits, '_' and '-'"
HEADER_WORDS = "a first row with the column names, such as cover,message"


@dataclass(frozen=True)
class Cell:
    """One cell: its text, without quotes and the blanks around it."""

    text: str
    quoted: bool
    place: Place

    @property
    def value(self) -> Scalar:
        """What the text stands for: a number, a truth value, None, or the text itself."""
        if self.quoted:
            return self.text
        if not self.text:
            return None
        if JSON_SCALAR.fullmatch(self.text) and len(self.text) <= LONGEST_NUMBER:
            value: Scalar = json.loads(self.text)
            return value
        return self.text

    def located(self, base: Path) -> Located:
        """The value with its place; `base` is the folder that paths are relative to."""
        typed = None if self.value is None or isinstance(self.value, str) else self.text
        return Located(self.value, self.place, base, typed=typed)


def read_table(path: Path, asked: Place, problems: Problems, wanted: Sequence[str] = ()) -> tuple[Located, ...] | None:
    """The rows under the header, each a mapping of the columns' names to scalars; paths are relative to the file.

    `wanted` are columns that it must have; it may have others. None, with every reason added to `problems`, if the
    table is missing or malformed; `asked` is the place that named it.
    """
    shown = str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        problems.add(asked, f"cannot read the table {shown!r}: {reason}; expected a CSV file with {HEADER_WORDS}")
        return None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8-sig")
        place = Place(shown, before.count("\n") + 1, len(before) - before.rfind("\n"))
        problems.add(place, f"not UTF-8: found the byte 0x{content[error.start]:02x}; save the table as UTF-8 text")
        return None
    return _Table(text, shown, path.parent, problems, wanted).rows()


class _Table:
    def __init__(self, text: str, file: str, base: Path, problems: Problems, wanted: Sequence[str]) -> None:
        self.text = text
        self.delimiter = _delimiter_of(text)
        self.file = file
        self.base = base
        self.problems = problems
        self.wanted = wanted
        self.lines = [0, *(match.end() for match in LINE_END.finditer(text))]

    def rows(self) -> tuple[Located, ...] | None:
        before = len(self.problems)
        cells = _without_empty_columns(list(self.cells()))
        if not cells:
            self.problems.add(Place(self.file, 1, 1), f"the table is empty; expected {HEADER_WORDS}")
            return None
        header, *body = cells
        names = self.names(header)
        if not body:
            self.problems.add(header[0].place, "the table has no rows; expected at least one below the column names")
        rows = [self.row(names, row, header) for row in body if self.is_whole(names, row)]
        return tuple(rows) if len(self.problems) == before else None

    def names(self, header: Sequence[Cell]) -> list[str]:
        texts = [cell.text.strip() for cell in header]
        names = [self.meant(text, texts) for text in texts]
        lacking = [name for name in self.wanted if name not in names]
        sound = len(set(names)) == len(names) and all(map(COLUMN.fullmatch, names))
        if lacking and (sound or len(lacking) == len(self.wanted)):
            found = f"the first row is {in_a_line(', '.join(texts), LONGEST_HEADER)}"
            expected = f"expected the column names {', '.join(self.wanted)}, as in the workflow"
            self.problems.add(header[0].place, f"{found}; {expected}")
            return names
        for index, (name, cell) in enumerate(zip(names, header, strict=True)):
            if not COLUMN.fullmatch(name):
                hint = "; separate the columns with commas" if re.search("[;\t|]", cell.text) else ""
                self.problems.add(cell.place, f"{cell.text!r} cannot name a column; expected {COLUMN_WORDS}{hint}")
            elif name in names[:index]:
                self.problems.add(cell.place, f"the column {name!r} appears twice; give each column its own name")
        return names

    def meant(self, text: str, texts: Sequence[str]) -> str:
        """The wanted column that a name in the first row differs from only in case; otherwise the name itself."""
        alike = [name for name in self.wanted if name.casefold() == text.casefold()]
        return alike[0] if len(alike) == 1 and alike[0] not in texts else text

    def is_whole(self, names: Sequence[str], row: Sequence[Cell]) -> bool:
        if len(row) == len(names):
            return True
        place = row[len(names)].place if len(row) > len(names) else row[0].place
        hint = f"; a cell with a {DELIMITERS[self.delimiter]} needs quotes" if len(row) > len(names) else ""
        found = f"{len(row)} cell{'s' * (len(row) != 1)}"
        self.problems.add(place, f"this row has {found}; expected {len(names)} ({', '.join(names)}){hint}")
        return False

    def row(self, names: Sequence[str], row: Sequence[Cell], header: Sequence[Cell]) -> Located:
        values = {name: cell.located(self.base) for name, cell in zip(names, row, strict=True)}
        keys = {name: cell.place for name, cell in zip(names, header, strict=True)}
        return Located(values, row[0].place, self.base, keys)

    def cells(self) -> Iterator[list[Cell]]:
        """The cells of every line that is not empty: spreadsheets write lines of empty cells below a table."""
        row: list[Cell] = []
        position = 0
        while position < len(self.text):
            match = CELLS[self.delimiter].match(self.text, position)
            assert match, "a bare cell goes on to the next delimiter or line, whatever it holds"
            row.append(self.cell(match))
            position = match.end()
            delimiter = self.text[position : position + 1]
            position += 2 if self.text.startswith("\r\n", position) else 1
            if delimiter == self.delimiter and position >= len(self.text):
                row.append(Cell("", False, self.place(len(self.text))))
            if delimiter != self.delimiter or position >= len(self.text):
                if any(cell.text or cell.quoted for cell in row):
                    yield row
                row = []

    def cell(self, match: re.Match[str]) -> Cell:
        quoted = match["quoted"] is not None
        text = match["quoted"].replace('""', '"') if quoted else match["bare"].strip()
        place = self.place(match.start() + len(match[0]) - len(match[0].lstrip(" \t")))
        if not quoted and text.startswith('"'):
            self.problems.add(place, f"the quotes of {text[:30]} do not end with the cell; double quotes inside them")
        if UNPRINTABLE.search(text):
            self.problems.add(place, f"{text[:30]!r} holds a control character; expected text")
        return Cell(text, quoted, place)

    def place(self, offset: int) -> Place:
        line = bisect_right(self.lines, offset)
        return Place(self.file, line, offset - self.lines[line - 1] + 1)


def _without_empty_columns(rows: Sequence[list[Cell]]) -> list[list[Cell]]:
    """The rows without the last columns, if those are empty in every row: spreadsheets go on writing emptied ones."""
    filled = (index for row in rows for index, cell in enumerate(row, start=1) if cell.text or cell.quoted)
    width = max(filled, default=0)
    return [row[:width] for row in rows]


def _delimiter_of(text: str) -> str:
    """The delimiter in the first line that is not empty; a comma if there is none, or more than one kind."""
    header = next((line for line in LINE_END.split(text) if line.strip()), "")
    found = [delimiter for delimiter in DELIMITERS if delimiter in header]
    return found[0] if len(found) == 1 else ","
