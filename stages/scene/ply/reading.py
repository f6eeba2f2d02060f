"""Reads PLY files and checks their contents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped

from pipeline.errors import UserError
from pipeline.plain_text import listed
from stages.scene.ply.header import ASCII, NAMES, REMEDY, read_header
from stages.scene.ply.rows import Elements, read_binary, read_text

ROWS_AT_ONCE = 65536


@dataclass(frozen=True)
class Ply:
    """The contents of a PLY file: comments, and each element's rows as a structured array, in the order of the file.

    `elements["vertex"]["x"]` is the column [N] of one property, in the type that it has in the file. The first element
    with lists, and all after it, are left out and named in `left_out`.
    """

    path: Path
    comments: tuple[str, ...]
    elements: Elements
    left_out: tuple[str, ...] = ()

    def rows(self, element: str) -> Shaped[np.ndarray, " N"]:
        """The rows of an element. Raises `UserError` if the file has none of that name, or it was left out."""
        if element in self.left_out:
            raise UserError(
                f"the element {element!r} of a PLY cannot be read",
                where=self.path,
                found=f"lists in {self.left_out[0]!r}",
                expected="no lists in it, nor in what stands before it",
                remedy="Export the file again without them.",
            )
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
        """The named properties of an element as columns, one each; C = 0 and N = 0 are allowed.

        Raises `UserError` if one is missing, is not of type float, or holds NaN or infinity, naming it and the row.
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
        types = types_of(self.rows(element).dtype)
        missing = [name for name in names if name not in types]
        if missing:
            raise UserError(
                f"{len(missing)} of {len(names)} properties of the element {element!r} are missing",
                where=self.path,
                found=f"no {listed(missing)} among {listed(list(types))}",
                expected=listed(names),
                remedy="Check that the file is of the kind needed here.",
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


def begins_as_ply(path: Path) -> bool:
    """Whether a file's first bytes are those of a PLY, whatever its name. Raises `UserError` if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(3) == b"ply"
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error


def read_ply(path: Path) -> Ply:
    """Read a PLY file of any of the three formats, in time and memory proportional to its size.

    Raises `UserError` for a missing file, a header that is not understood or longer than 1 MiB, and fewer or more rows
    than the header states.
    """
    try:
        if not path.is_file():
            raise UserError("no such PLY file", where=path, found="a folder" if path.is_dir() else "nothing")
        with path.open("rb") as file:
            header = read_header(path, file)
            read = read_text if header.format == ASCII else read_binary
            left_out = tuple(element.name for element in header.elements[len(header.tables) :])
            return Ply(path, header.comments, read(path, file, header), left_out)
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error


def types_of(row: np.dtype) -> dict[str, np.dtype]:
    """The type of each property of a row."""
    return {name: row[name] for name in row.names or ()}
