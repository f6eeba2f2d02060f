"""The rows behind a PLY's header, binary or text.

Files may come from strangers. What a header claims is checked against the file's size before memory is allocated, so
reading takes time and memory proportional to the file.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from jaxtyping import Float64, Shaped

from pipeline.errors import UserError
from stages.scene.ply.header import BYTE_ORDERS, REMEDY, Element, Header

Elements = Mapping[str, Shaped[np.ndarray, " _"]]
"""Rows by element name: little-endian structured arrays with a field for each property."""


def read_binary(path: Path, file: BinaryIO, header: Header) -> Elements:
    """The rows of all tables. Raises `UserError` if the file holds fewer or more than the header states."""
    found = os.fstat(file.fileno()).st_size - header.length
    expected = sum(element.size for element in header.tables)
    _check_size(path, header, f"{found} bytes", f"{expected} bytes", found - expected)
    file.seek(header.length)
    return {element.name: _rows(path, file, element, BYTE_ORDERS[header.format]) for element in header.tables}


def read_text(path: Path, file: BinaryIO, header: Header) -> Elements:
    """The rows of all tables, from numbers separated by blanks.

    Raises `UserError` as `read_binary` does, and for anything that is not a number or does not fit its type.
    """
    tables = header.tables
    counts = [element.count * len(element.properties) for element in tables]
    file.seek(header.length)
    body = file.read()
    if 2 * sum(counts) > len(body) + 1:  # a digit and a blank each
        _check_size(path, header, f"{len(body)} bytes", f"{sum(counts)} numbers", -1)
    try:
        numbers = _numbers(body)
    except ValueError as error:
        raise UserError("an ASCII PLY contains a value that is not a number", where=path, remedy=REMEDY) from error
    _check_size(path, header, f"{len(numbers)} numbers", f"{sum(counts)} numbers", len(numbers) - sum(counts))
    elements: dict[str, Shaped[np.ndarray, " N"]] = {}
    start = 0
    for element, count in zip(tables, counts, strict=True):
        table = numbers[start : start + count].reshape(element.count, len(element.properties))
        elements[element.name] = _rows_of_text(path, element, table)
        start += count
    return elements


def _numbers(body: bytes) -> Float64[np.ndarray, " n"]:
    """All numbers of a text, those of lists included. None in a blank text, where `np.fromstring` makes one up.

    Nor is it asked for a number of them: in place of those that are missing it returns uninitialised memory.
    """
    blank = not body or body.isspace()
    return np.empty(0) if blank else np.fromstring(body, np.float64, sep=" ")


def _check_size(path: Path, header: Header, found: str, expected: str, surplus: int) -> None:
    whole = len(header.tables) == len(header.elements)
    if surplus < 0 or (surplus and whole):
        rows = " and ".join(f"{element.count} rows of {element.name}" for element in header.tables[:3]) or "no rows"
        raise UserError(
            "a PLY that is cut off" if surplus < 0 else "a PLY that is longer than its header says",
            where=path,
            found=f"{found} after the header",
            expected=f"{expected} for {rows}",
            remedy=REMEDY,
        )


def _rows(path: Path, file: BinaryIO, element: Element, byte_order: Literal["<", ">"]) -> Shaped[np.ndarray, " N"]:
    rows = np.fromfile(file, element.row(byte_order), element.count)
    if len(rows) != element.count:
        raise UserError("became shorter while it was read", where=path)
    return rows if byte_order == "<" else rows.astype(element.row())


def _rows_of_text(path: Path, element: Element, table: Float64[np.ndarray, "N C"]) -> Shaped[np.ndarray, " N"]:
    rows = np.empty(element.count, element.row())
    for (name, dtype), column in zip(element.properties.items(), table.T, strict=True):
        if dtype.kind in "iu":
            limits = np.iinfo(dtype)
            if not ((column >= limits.min) & (column <= limits.max) & (column == np.trunc(column))).all():
                raise UserError(
                    f"property {name} of {element.name} holds numbers that its type does not have", where=path
                )
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which readers refuse
            rows[name] = column
    return rows
