"""PLY files of all three formats as tables of numbers, whatever these mean.

Files come from strangers. What a header claims is held against the size of the file before any room is made for it, so
that reading takes time and memory in proportion to the file and no more.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from pipeline.errors import UserError

Elements = Mapping[str, Shaped[np.ndarray, " N"]]
"""Each element's rows by its name: a structured array with a field for every property."""

MAGIC = re.compile(rb"ply[ \t]*\r?\n")
LARGEST_HEADER = 2**16  # bytes; 3DGS's headers take 2,000
END_OF_HEADER = re.compile(rb"\nend_header[ \t]*\r?\n")
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
CODES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
CODES |= {"float": "f4", "double": "f8"}
CODES |= {np.dtype(code).name: code for code in list(CODES.values())}  # `float32` is a newer name of `float`
COUNT = re.compile(r"[0-9]{1,20}")
REMEDY = "Export the file again, or fetch it again where it came from."


@dataclass
class Element:
    """An element as the header declares it; one that holds lists has no rows of one size."""

    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)
    has_lists: bool = False

    def row(self, byte_order: str) -> np.dtype:
        """The type of a row."""
        return np.dtype([(name, byte_order + code) for name, code in self.properties.items()])


def read_elements(path: Path) -> Elements:
    """The elements of a PLY file up to the first that holds lists, which is left out as all that follow.

    Raises `UserError` for a header that is not understood or longer than 64 KiB, and for a file that holds fewer or
    more rows than its header says.
    """
    content = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.empty(0, np.uint8)
    lines, length = _header(path, content[:LARGEST_HEADER].tobytes())
    byte_order, declared = _format(path, lines), _declared(path, lines)
    lists = [element.has_lists for element in declared]
    tables = declared[: lists.index(True)] if True in lists else declared
    read = _read_text if byte_order == "=" else _read_binary
    return read(path, content[length:], tables, byte_order, len(tables) == len(declared))


def _header(path: Path, head: bytes) -> tuple[list[str], int]:
    """The header's lines without the first and the last, and how many bytes it takes."""
    begins, ends = MAGIC.match(head), END_OF_HEADER.search(head)
    if begins is None or ends is None:
        raise UserError(
            "a PLY without a whole header",
            where=path,
            found="no line 'end_header'" if begins else f"the first bytes {head[:8]!r}",
            expected=f"'ply' to 'end_header' within {LARGEST_HEADER} bytes",
            remedy=REMEDY,
        )
    text = head[begins.end() : ends.start() + 1].decode("utf-8", errors="replace")
    return [line.strip() for line in text.split("\n")], ends.end()


def _format(path: Path, lines: Sequence[str]) -> str:
    formats = [line for line in lines if line.split()[:1] == ["format"]]
    match [line.split() for line in formats]:
        case [["format", name, "1.0"]] if name in BYTE_ORDERS:
            return BYTE_ORDERS[name]
    raise UserError(
        "a PLY of an unknown format",
        where=path,
        found=repr("; ".join(formats)[:80]) if formats else "no line 'format'",
        expected=f"one of {', '.join(BYTE_ORDERS)}, version 1.0",
        remedy=REMEDY,
    )


def _declared(path: Path, lines: Sequence[str]) -> list[Element]:
    elements: list[Element] = []
    for number, line in enumerate(lines, start=2):
        match line.split():
            case [] | ["format" | "comment" | "obj_info", *_]:
                continue
            case ["element", name, count] if COUNT.fullmatch(count) and name not in [one.name for one in elements]:
                elements.append(Element(name, int(count)))
            case ["property", kind, name] if kind in CODES and elements and name not in elements[-1].properties:
                elements[-1].properties[name] = CODES[kind]
            case ["property", "list", size, kind, _] if size in CODES and kind in CODES and elements:
                elements[-1].has_lists = True
            case _:
                raise UserError(
                    f"line {number} of a PLY's header is not understood",
                    where=path,
                    found=repr(line[:80]),
                    expected="an element with its number of rows, or a property with its type; each name once",
                    remedy=REMEDY,
                )
    for element in elements:
        if not element.properties and not element.has_lists:
            raise UserError(f"the element {element.name[:40]!r} has no properties", where=path, remedy=REMEDY)
    return elements


def _read_binary(
    path: Path, body: Shaped[np.ndarray, " B"], tables: Sequence[Element], byte_order: str, whole: bool
) -> Elements:
    sizes = [element.count * element.row(byte_order).itemsize for element in tables]
    _check_size(path, tables, f"{len(body)} bytes", f"{sum(sizes)} bytes", len(body) - sum(sizes), whole)
    ends = np.cumsum([0, *sizes])
    return {
        element.name: body[start : start + size].view(element.row(byte_order))
        for element, start, size in zip(tables, ends[:-1], sizes, strict=True)
    }


def _read_text(
    path: Path, body: Shaped[np.ndarray, " B"], tables: Sequence[Element], byte_order: str, whole: bool
) -> Elements:
    counts = [element.count * len(element.properties) for element in tables]
    if 2 * sum(counts) > len(body) + 1:  # a digit and a blank each
        _check_size(path, tables, f"{len(body)} bytes", f"{sum(counts)} numbers", -1, whole)
    try:
        numbers = np.fromstring(body.tobytes(), np.float64, count=-1 if whole else sum(counts), sep=" ")
    except ValueError as error:
        raise UserError("an ASCII PLY holds what is no number", where=path, remedy=REMEDY) from error
    _check_size(path, tables, f"{len(numbers)} numbers", f"{sum(counts)}", len(numbers) - sum(counts), whole)
    elements, start = {}, 0
    for element, count in zip(tables, counts, strict=True):
        table = numbers[start : start + count].reshape(element.count, len(element.properties))
        elements[element.name] = _rows_of_text(path, element, table)
        start += count
    return elements


def _rows_of_text(path: Path, element: Element, table: Shaped[np.ndarray, "N C"]) -> Shaped[np.ndarray, " N"]:
    rows = np.empty(element.count, element.row("="))
    for (name, code), column in zip(element.properties.items(), table.T, strict=True):
        if np.dtype(code).kind in "iu":
            limits = np.iinfo(code)
            if not ((column >= limits.min) & (column <= limits.max) & (column == np.trunc(column))).all():
                raise UserError(
                    f"property {name} of {element.name} holds numbers that its type does not have", where=path
                )
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which readers refuse
            rows[name] = column
    return rows


def _check_size(path: Path, tables: Sequence[Element], found: str, expected: str, surplus: int, whole: bool) -> None:
    if surplus < 0 or (surplus and whole):
        rows = " and ".join(f"{element.count} rows of {element.name[:40]}" for element in tables[:3]) or "no rows"
        raise UserError(
            "a PLY that is cut off" if surplus < 0 else "a PLY that is longer than its header says",
            where=path,
            found=f"{found} after the header",
            expected=f"{expected} for {rows}",
            remedy=REMEDY,
        )
