"""Tables in CSV files, whose every cell knows its place.

    cover,message
    photos/kitchen,photos/fox
    photos/garden,"photos/2024"

The first row names the columns. A cell is a number, `true`, `false` or nothing as JSON spells them, and else a text;
in quotes it is always a text. Cells are parted by commas, blanks around them do not count, and neither do empty lines.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import Place
from pipeline.located import Located, Problems, Scalar

CELL = re.compile(r'[ \t]*(?:"(?P<quoted>[^"]*(?:""[^"]*)*)"[ \t]*|(?P<bare>[^,\r\n]*))(?=[,\r\n]|\Z)')
JSON_SCALAR = re.compile(r"true|false|null|-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?")
UNPRINTABLE = re.compile(r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]")
LONGEST_NUMBER = 300  # digits; what is longer is a text, as Python reads no number of thousands of them
COLUMN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
COLUMN_WORDS = "letters, digits, '_' and '-'"
HEADER_WORDS = "a first row with the columns' names, such as cover,message"


@dataclass(frozen=True)
class Cell:
    text: str
    quoted: bool
    place: Place

    @property
    def value(self) -> Scalar:
        if self.quoted:
            return self.text
        if not self.text:
            return None
        if JSON_SCALAR.fullmatch(self.text) and len(self.text) <= LONGEST_NUMBER:
            value: Scalar = json.loads(self.text)
            return value
        return self.text


def read_table(path: Path, asked: Place, problems: Problems) -> tuple[Located, ...] | None:
    """The rows under the header, each a mapping of the columns' names to scalars; paths are relative to the file.

    None, with the reason among `problems`, where there is no such table; `asked` is the place that named it.
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
    return _Table(text, shown, path.parent, problems).rows()


class _Table:
    def __init__(self, text: str, file: str, base: Path, problems: Problems) -> None:
        self.text = text
        self.file = file
        self.base = base
        self.problems = problems
        self.lines = [0, *(match.end() for match in re.finditer("\r\n|\r|\n", text))]

    def rows(self) -> tuple[Located, ...] | None:
        before = len(self.problems)
        cells = list(self.cells())
        if not cells:
            self.problems.add(Place(self.file, 1, 1), f"the table is empty; expected {HEADER_WORDS}")
            return None
        header, *body = cells
        names = self.names(header)
        if not body:
            self.problems.add(header[0].place, "the table has no rows; expected at least one under the columns' names")
        rows = [self.row(names, row, header) for row in body if self.is_whole(names, row)]
        return tuple(rows) if len(self.problems) == before else None

    def names(self, header: Sequence[Cell]) -> list[str]:
        names: list[str] = []
        for cell in header:
            if not COLUMN.fullmatch(cell.text):
                hint = "; part the columns with commas" if re.search("[;\t|]", cell.text) else ""
                self.problems.add(cell.place, f"{cell.text!r} cannot name a column; expected {COLUMN_WORDS}{hint}")
            elif cell.text in names:
                self.problems.add(cell.place, f"the column {cell.text!r} is there twice; give each a name of its own")
            names.append(cell.text)
        return names

    def is_whole(self, names: Sequence[str], row: Sequence[Cell]) -> bool:
        if len(row) == len(names):
            return True
        place = row[len(names)].place if len(row) > len(names) else row[0].place
        hint = "; a cell with a comma needs quotes" if len(row) > len(names) else ""
        found = f"{len(row)} cell{'s' * (len(row) != 1)}"
        self.problems.add(place, f"this row has {found}; expected {len(names)} ({', '.join(names)}){hint}")
        return False

    def row(self, names: Sequence[str], row: Sequence[Cell], header: Sequence[Cell]) -> Located:
        values = {name: Located(cell.value, cell.place, self.base) for name, cell in zip(names, row, strict=True)}
        keys = {name: cell.place for name, cell in zip(names, header, strict=True)}
        return Located(values, row[0].place, self.base, keys)

    def cells(self) -> Iterator[list[Cell]]:
        """The cells of every line that is not empty."""
        row: list[Cell] = []
        position = 0
        while position < len(self.text):
            match = CELL.match(self.text, position)
            assert match, "a bare cell goes on to the next comma or line, whatever it holds"
            row.append(self.cell(match))
            position = match.end()
            delimiter = self.text[position : position + 1]
            position += 2 if self.text.startswith("\r\n", position) else 1
            if delimiter == "," and position >= len(self.text):
                row.append(Cell("", False, self.place(len(self.text))))
            if delimiter != "," or position >= len(self.text):
                if len(row) > 1 or row[0].text or row[0].quoted:
                    yield row
                row = []

    def cell(self, match: re.Match[str]) -> Cell:
        quoted = match["quoted"] is not None
        text = match["quoted"].replace('""', '"') if quoted else match["bare"].strip()
        place = self.place(match.start() + len(match[0]) - len(match[0].lstrip(" \t")))
        if not quoted and text.startswith('"'):
            self.problems.add(place, f"the quotes of {text[:30]} do not end with the cell; double a quote inside them")
        if UNPRINTABLE.search(text):
            self.problems.add(place, f"{text[:30]!r} holds a control character; expected text")
        return Cell(text, quoted, place)

    def place(self, offset: int) -> Place:
        line = bisect_right(self.lines, offset)
        return Place(self.file, line, offset - self.lines[line - 1] + 1)
