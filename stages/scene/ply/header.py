"""The header of a PLY file: its elements, and the number of rows and the properties of each.

Files may come from strangers: memory is allocated for the header itself, never for what it claims.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

from pipeline.errors import UserError

ASCII, LITTLE_ENDIAN, BIG_ENDIAN = "ascii", "binary_little_endian", "binary_big_endian"
BYTE_ORDERS: Mapping[str, Literal["<", ">"]] = {LITTLE_ENDIAN: "<", BIG_ENDIAN: ">", ASCII: "<"}
"""Byte order of the rows, by format; rows of text are held as little-endian."""

LARGEST_HEADER = 2**20  # bytes: room for tens of thousands of properties; 3DGS's headers take 2,000
MAGIC = re.compile(rb"ply[ \t]*\r?\n")
ZIP = b"PK\x03\x04"
END_OF_HEADER = re.compile(rb"\nend_header[ \t]*\r?\n")
COUNT = re.compile(r"[0-9]{1,20}")
NAME = re.compile(r"[!-~]{1,100}")
REMEDY = "Export the file again as binary little-endian PLY, or fetch it again where it came from."

CODES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2"}
CODES |= {"int": "i4", "uint": "u4", "float": "f4", "double": "f8"}
TYPES = {name: np.dtype("<" + code) for name, code in CODES.items()}
NAMES = {dtype: name for name, dtype in TYPES.items()}
TYPES |= {dtype.name: dtype for dtype in list(TYPES.values())}
"""NumPy types by the names of PLY types, old (`float`) and new (`float32`); `NAMES` gives the old names."""


@dataclass
class Element:
    """An element as the header declares it; rows of one with lists vary in size."""

    name: str
    count: int
    properties: dict[str, np.dtype] = field(default_factory=dict)
    has_lists: bool = False

    def row(self, byte_order: Literal["<", ">"] = "<") -> np.dtype:
        """The structured type of a row."""
        return np.dtype([(name, dtype.newbyteorder(byte_order)) for name, dtype in self.properties.items()])

    @property
    def size(self) -> int:
        """Bytes of all rows in a binary file."""
        return self.count * sum(dtype.itemsize for dtype in self.properties.values())


@dataclass(frozen=True)
class Header:
    """`format` is a key of `BYTE_ORDERS`, `length` the header's size in bytes."""

    format: str
    comments: tuple[str, ...]
    elements: tuple[Element, ...]
    length: int

    @property
    def tables(self) -> tuple[Element, ...]:
        """The elements before the first with lists: only reading the lists would tell where later elements begin."""
        lists = [element.has_lists for element in self.elements]
        return self.elements[: lists.index(True)] if True in lists else self.elements


def read_header(path: Path, file: BinaryIO) -> Header:
    """The header of a file positioned at its start.

    Raises `UserError` if it is not understood, or longer than 1 MiB.
    """
    head = file.read(min(LARGEST_HEADER, os.fstat(file.fileno()).st_size))
    begins = MAGIC.match(head)
    if begins is None:
        raise _no_ply(path, head)
    ends = END_OF_HEADER.search(head)
    if ends is None:
        raise UserError(
            "a PLY whose header does not end",
            where=path,
            found=f"no line 'end_header' in the first {len(head)} bytes",
            expected=f"a header of at most {LARGEST_HEADER} bytes",
            remedy=REMEDY,
        )
    text = head[begins.end() : ends.start() + 1].decode("utf-8", errors="replace")
    lines = [line.strip() for line in text.split("\n")]
    comments = tuple(line.removeprefix("comment").strip() for line in lines if line.startswith("comment "))
    return Header(_format(path, lines), comments, tuple(_elements(path, lines)), ends.end())


def _no_ply(path: Path, head: bytes) -> UserError:
    """The error for any other file, by its first bytes. People who are sent a folder often have it as a zip."""
    zipped = head.startswith(ZIP)
    return UserError(
        "not a PLY file",
        where=path,
        found="a zip" if zipped else f"a file that begins with {_first_bytes(head)}" if head else "an empty file",
        expected="a file whose first line is ply",
        remedy="Unpack it, and give the folder or the PLY that was in it." if zipped else REMEDY,
    )


def _first_bytes(head: bytes) -> str:
    """As text if printable, else in hexadecimal."""
    text = head[:8].decode("ascii", errors="replace")
    return text if text.isascii() and text.isprintable() else f"the bytes {head[:8].hex(' ')}"


def _format(path: Path, lines: Sequence[str]) -> str:
    formats = [line for line in lines if line.split()[:1] == ["format"]]
    match [line.split() for line in formats]:
        case [["format", name, "1.0"]] if name in BYTE_ORDERS:
            return name
    raise UserError(
        "a PLY of an unknown format",
        where=path,
        found=repr("; ".join(formats)[:80]) if formats else "no line 'format'",
        expected=f"one of {', '.join(BYTE_ORDERS)}, version 1.0",
        remedy=REMEDY,
    )


def _elements(path: Path, lines: Sequence[str]) -> list[Element]:
    elements: dict[str, Element] = {}
    for number, line in enumerate(lines, start=2):
        match line.split():
            case [] | ["format" | "comment" | "obj_info", *_]:
                continue
            case ["element", name, count] if _is_new(name, elements) and COUNT.fullmatch(count):
                elements[name] = Element(name, int(count))
            case ["property", kind, name] if kind in TYPES and elements and _is_new(name, _last(elements).properties):
                _last(elements).properties[name] = TYPES[kind]
            case ["property", "list", size, kind, _] if size in TYPES and kind in TYPES and elements:
                _last(elements).has_lists = True
            case _:
                raise UserError(
                    f"line {number} of a PLY's header is not understood",
                    where=path,
                    found=repr(line[:80]),
                    expected="an element with its number of rows, or a property with its type; each name once",
                    remedy=REMEDY,
                )
    for element in elements.values():
        if not element.properties and not element.has_lists:
            raise UserError(f"the element {element.name!r} of a PLY has no properties", where=path, remedy=REMEDY)
    return list(elements.values())


def _is_new(name: str, taken: Mapping[str, object]) -> bool:
    return bool(NAME.fullmatch(name)) and name not in taken


def _last(elements: dict[str, Element]) -> Element:
    return elements[next(reversed(elements))]
