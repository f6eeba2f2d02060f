"""Figures measured under a condition: an attack of some severity, a detector on a class of pictures, a wrong key.

Figures of a trained scene itself are rows of `imaging.metric_table`. Measurements have their own columns and their own
kind of artifact, so that the quality after an attack cannot be mistaken for the fidelity of the attacked container.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError

KIND = "measurements"
MEASUREMENTS_FILE = "measurements.jsonl"


@dataclass(frozen=True)
class Measurement:
    """One measured figure. A column that does not apply is ``None``.

    quantity: what was measured, such as "psnr"; value: NaN if it could not be measured; condition: under which it was
    measured, such as "random_pruning" or "photos"; severity: the strength of the condition, in the condition's unit;
    seed: that of the condition's randomness; view, split, message and method: as in ``metric_table.MetricRow``.
    """

    quantity: str
    value: float
    condition: str
    severity: float | None = None
    seed: int | None = None
    view: str | None = None
    split: str | None = None
    message: str | None = None
    method: str | None = None


def write_measurements(writer: ArtifactWriter, rows: Iterable[Measurement]) -> None:
    """Writes the rows in order, one JSON object per line, without the columns that do not apply."""
    writer.write_file(MEASUREMENTS_FILE, to_lines(rows))


def read_measurements(artifact: Artifact) -> tuple[Measurement, ...]:
    """The rows of a ``measurements`` artifact, in the order written; empty if there are none.

    Raises ``UserError`` with the file and line if a row is malformed.
    """
    path = artifact.file(MEASUREMENTS_FILE)
    return from_lines(path.read_text(encoding="utf-8"), str(path))


def to_lines(rows: Iterable[Measurement]) -> str:
    """The rows as text, one JSON object per line."""
    return "".join(_to_line(row) for row in rows)


def from_lines(text: str, where: str) -> tuple[Measurement, ...]:
    """The rows of a text by `to_lines`. Raises `UserError`, with `where` and the line, if a row is malformed."""
    return tuple(_from_line(line, f"{where}, line {number}") for number, line in enumerate(text.splitlines(), start=1))


def _to_line(row: Measurement) -> str:
    fields = {name: value for name, value in dataclasses.asdict(row).items() if value is not None}
    if not math.isfinite(row.value):  # JSON has no NaN or infinity; float() reads these strings back
        fields["value"] = str(row.value)
    return json.dumps(fields, allow_nan=False) + "\n"  # ASCII, as names may hold U+2028, at which splitlines() splits


def _from_line(line: str, where: str) -> Measurement:
    try:
        fields = json.loads(line)
        return Measurement(**{**fields, "value": float(fields["value"])})
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            "a measurement cannot be read", where=where, found=line[:120], expected="a JSON object of Measurement"
        ) from error
