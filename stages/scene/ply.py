"""PLY files as tables of numbers: what an element's properties are called and hold, whatever they mean.

Files come from strangers. What a header claims is held against the size of the file before any room is made for it, so
that reading takes time and memory in proportion to the file and no more.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32, Shaped

from pipeline.errors import UserError

FORMAT = "format binary_little_endian 1.0"
LARGEST_HEADER = 2**20  # bytes: room for tens of thousands of properties
END_OF_HEADER = re.compile(rb"\nend_header[ \t]*\r?\n")
COUNT = re.compile(r"[0-9]{1,20}")
NAME = re.compile(r"[!-~]{1,100}")
ROWS_AT_ONCE = 65536
REMEDY = "Export the file again as binary little-endian PLY, or fetch it again where it came from."

CODES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2"}
CODES |= {"int": "<i4", "uint": "<u4", "float": "<f4", "double": "<f8"}
TYPES = {name: np.dtype(code) for name, code in CODES.items()}
TYPES |= {dtype.name: dtype for dtype in list(TYPES.values())}
"""NumPy's type for each name of a PLY property's, old (`float`) and new (`float32`)."""
NAMES = {TYPES[name]: name for name in CODES}


@dataclass(frozen=True)
class Ply:
    """What a PLY file holds: its comments, and each element's rows as a structured array, in the order of the file.

    `elements["vertex"]["x"]` is the column [N] of one property, in the type that it has in the file.
    """

    path: Path
    comments: tuple[str, ...]
    elements: Mapping[str, Shaped[np.ndarray, " N"]]

    def rows(self, element: str) -> Shaped[np.ndarray, " N"]:
        """The rows of an element. Raises `UserError` where the file has none of that name."""
        if element not in self.elements:
            raise UserError(
                f"a PLY without the element {element!r}",
                where=self.path,
                found=f"the elements {', '.join(self.elements)}" if self.elements else "no elements",
                expected=f"an element {element!r}",
                remedy=REMEDY,
            )
        return self.elements[element]

    def floats(self, element: str, names: Sequence[str]) -> Float32[np.ndarray, "N C"]:
        """The named properties of an element side by side, one column each; C = 0 and N = 0 included.

        Raises `UserError` where one is missing, is not of type float, or holds NaN or infinity, naming it and the row.
        """
        rows = self.rows(element)
        self._check_floats(element, names)
        values = np.empty((len(rows), len(names)), np.float32)
        for start in range(0, len(rows), ROWS_AT_ONCE):
            block = slice(start, start + ROWS_AT_ONCE)
            for column, name in enumerate(names):
                values[block, column] = rows[name][block]
            self._check_finite(values[block], names, start)
        return values

    def _check_floats(self, element: str, names: Sequence[str]) -> None:
        types = _types(self.rows(element).dtype)
        missing = [name for name in names if name not in types]
        if missing:
            raise UserError(
                f"{len(missing)} of {len(names)} properties of the element {element!r} are missing",
                where=self.path,
                found=f"no {_listed(missing)} among {_listed(list(types))}",
                expected=_listed(names),
                remedy="Check that the file is of the kind that is asked for here.",
            )
        for name in names:
            if types[name] != np.float32:
                raise UserError(
                    f"the property {name!r} is of another type",
                    where=self.path,
                    found=NAMES[types[name]],
                    expected="float",
                    remedy=REMEDY,
                )

    def _check_finite(self, values: Float32[np.ndarray, "N C"], names: Sequence[str], start: int) -> None:
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            raise UserError(
                f"the property {names[column]!r} of row {start + row} is not finite",
                where=self.path,
                found=values[row, column],
                expected="a finite number",
                remedy=REMEDY,
            )


@dataclass
class _Element:
    """An element as the header declares it."""

    name: str
    count: int
    properties: dict[str, np.dtype] = field(default_factory=dict)

    @property
    def row(self) -> np.dtype:
        return np.dtype(list(self.properties.items()))

    @property
    def size(self) -> int:
        """Bytes of all rows."""
        return self.count * sum(dtype.itemsize for dtype in self.properties.values())


def read_ply(path: Path) -> Ply:
    """Read a binary little-endian PLY of scalar properties.

    Raises `UserError` for other formats, lists, a header that is not understood or longer than 1 MiB, and a file that
    is longer or shorter than its header says.
    """
    try:
        if not path.is_file():
            raise UserError("no such PLY file", where=path, found="a folder" if path.is_dir() else "nothing")
        with path.open("rb") as file:
            lines, length = _header(path, file)
            comments = tuple(line.removeprefix("comment").strip() for line in lines if line.startswith("comment "))
            declared = _declared(path, lines)
            _check_size(path, declared, length, os.fstat(file.fileno()).st_size)
            file.seek(length)
            return Ply(path, comments, {element.name: _rows(path, file, element) for element in declared})
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error


def _header(path: Path, file: BinaryIO) -> tuple[list[str], int]:
    """The lines of the header without the first and the last, and how many bytes it takes."""
    head = file.read(LARGEST_HEADER)
    if not re.match(rb"ply[ \t]*\r?\n", head):
        raise UserError("no PLY file", where=path, found=f"the first bytes {head[:8]!r}", expected="b'ply\\n'")
    end = END_OF_HEADER.search(head)
    if end is None:
        raise UserError(
            "a PLY whose header does not end",
            where=path,
            found=f"no line 'end_header' in the first {len(head)} bytes",
            expected=f"a header of at most {LARGEST_HEADER} bytes",
            remedy=REMEDY,
        )
    lines = [line.strip() for line in head[: end.start()].decode("utf-8", errors="replace").split("\n")[1:]]
    formats = [line for line in lines if line.split()[:1] == ["format"]]
    if [line.split() for line in formats] != [FORMAT.split()]:
        raise UserError(
            "a PLY of another format",
            where=path,
            found=repr(_listed(formats)[:80]) if formats else "no line 'format'",
            expected=FORMAT,
            remedy=REMEDY,
        )
    return lines, end.end()


def _declared(path: Path, lines: Sequence[str]) -> list[_Element]:
    elements: dict[str, _Element] = {}
    for number, line in enumerate(lines, start=2):
        match line.split():
            case [] | ["format" | "comment" | "obj_info", *_]:
                continue
            case ["element", name, count] if _is_new(name, elements) and COUNT.fullmatch(count):
                elements[name] = _Element(name, int(count))
            case ["property", kind, name] if kind in TYPES and elements and _is_new(name, _last(elements).properties):
                _last(elements).properties[name] = TYPES[kind]
            case _:
                raise UserError(
                    f"line {number} of a PLY's header is not understood",
                    where=path,
                    found=repr(line[:80]),
                    expected="an element with its number of rows, or a property that is one number; each name once",
                    remedy=REMEDY,
                )
    for element in elements.values():
        if not element.properties:
            raise UserError(f"the element {element.name!r} of a PLY has no properties", where=path, remedy=REMEDY)
    return list(elements.values())


def _is_new(name: str, taken: Mapping[str, object]) -> bool:
    return bool(NAME.fullmatch(name)) and name not in taken


def _last(elements: dict[str, _Element]) -> _Element:
    return elements[next(reversed(elements))]


def _check_size(path: Path, declared: Sequence[_Element], header: int, size: int) -> None:
    expected = header + sum(element.size for element in declared)
    if size != expected:
        rows = " and ".join(f"{element.count} of {element.name}" for element in declared[:3]) or "none"
        raise UserError(
            f"a PLY that is {'cut off' if size < expected else 'longer than its header says'}",
            where=path,
            found=f"{size} bytes",
            expected=f"{expected} bytes for its rows ({rows})",
            remedy=REMEDY,
        )


def _rows(path: Path, file: BinaryIO, element: _Element) -> Shaped[np.ndarray, " N"]:
    rows = np.fromfile(file, element.row, element.count)
    if len(rows) != element.count:
        raise UserError("became shorter while it was read", where=path)
    return rows


def write_ply(
    path: Path, columns: Mapping[str, Shaped[np.ndarray, " N"]], comments: Sequence[str] = (), element: str = "vertex"
) -> None:
    """Write one element with a property for each of the `columns`, which have N values each, N = 0 included.

    Types are those of NumPy that PLY has (integers up to 32 bits, floats of 32 and 64). Raises `ValueError` for others,
    for no column or columns of different lengths, and for names and comments that a header cannot hold.
    """
    row = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    counts = {len(column) for column in columns.values()}
    if len(counts) != 1 or not all(column.ndim == 1 for column in columns.values()):
        raise ValueError(f"columns of different lengths: {sorted(counts)}")
    (count,) = counts
    header = _header_of(element, count, row, comments)
    with path.open("wb") as file:
        file.write(header)
        for start in range(0, count, ROWS_AT_ONCE):
            rows = np.empty(min(ROWS_AT_ONCE, count - start), row)
            for name, column in columns.items():
                rows[name] = column[start : start + ROWS_AT_ONCE]
            file.write(rows.tobytes())


def _header_of(element: str, count: int, row: np.dtype, comments: Sequence[str]) -> bytes:
    types = _types(row)
    for name in (element, *types):
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r} cannot name an element or property of a PLY")
    if any("\n" in comment or "\r" in comment for comment in comments):
        raise ValueError("a comment of a PLY is one line")
    unknown = [str(kind) for kind in types.values() if kind not in NAMES]
    if unknown:
        raise ValueError(f"PLY has no type for {_listed(unknown)}")
    lines = ["ply", FORMAT, *(f"comment {comment}" for comment in comments), f"element {element} {count}"]
    lines += [f"property {NAMES[kind]} {name}" for name, kind in types.items()]
    header = "\n".join([*lines, "end_header", ""]).encode()
    if len(header) > LARGEST_HEADER:
        raise ValueError(f"a PLY header of {len(header)} bytes; at most {LARGEST_HEADER} can be read again")
    return header


def _types(row: np.dtype) -> dict[str, np.dtype]:
    return {name: row[name] for name in row.names or ()}


def _listed(names: Sequence[str]) -> str:
    """The names, or the first of many."""
    return ", ".join(names) if len(names) <= 8 else f"{', '.join(names[:8])} and {len(names) - 8} more"
