"""Reader for binary PLY files, whose header lists the elements and their properties."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_CODES = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")
_TYPES = {
    name: code
    for names in (
        "char uchar short ushort int uint float double",
        "int8 uint8 int16 uint16 int32 uint32 float32 float64",
    )
    for name, code in zip(names.split(), _CODES, strict=True)
}
_END = b"end_header\n"


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Read a little-endian PLY file. Returns the rows of each element as a structured array, by name.

    Raises ValueError for any other file, for list properties, and if the file is truncated.
    """
    content = path.read_bytes()
    header_length = content.find(_END) + len(_END)
    if not content.startswith(b"ply\n") or header_length < len(_END):
        raise ValueError(f"{path}: no PLY header from 'ply' to 'end_header'")
    lines = content[:header_length].decode("ascii", errors="replace").splitlines()
    if "format binary_little_endian 1.0" not in lines:
        raise ValueError(f"{path}: expected a PLY of format binary_little_endian 1.0")
    elements, offset = {}, header_length
    for name, count, row in _elements(path, lines):
        end = offset + count * row.itemsize
        if end > len(content):
            raise ValueError(
                f"{path}: truncated: found {len(content)} bytes, expected {end} or more, up to the last row of {name}"
            )
        elements[name] = np.frombuffer(content, row, count, offset)
        offset = end
    return elements


def _elements(path: Path, lines: list[str]) -> list[tuple[str, int, np.dtype]]:
    """(name, number of rows, dtype of a row) of each element in the header."""
    found: list[tuple[str, int, list[tuple[str, str]]]] = []
    for number, line in enumerate(lines, start=1):
        match line.split():
            case ["element", name, count] if count.isdecimal():
                found.append((name, int(count), []))
            case ["property", kind, name] if kind in _TYPES and found:
                found[-1][2].append((name, _TYPES[kind]))
            case [("element" | "property"), *_]:
                raise ValueError(
                    f"{path}, header line {number}: found {line!r}, expected an element of scalar properties"
                )
    return [(name, count, np.dtype(fields)) for name, count, fields in found]
