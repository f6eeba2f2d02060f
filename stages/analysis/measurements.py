"""What was measured under a condition: an attack of some severity, a detector on a class of pictures, a wrong key.

Figures of a trained scene as it is are rows of `imaging.metric_table`. These have columns of their own, and are a kind
of artifact of their own, so that no attack can be mistaken for the fidelity of what was attacked.
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
    """One figure. ``None`` where a column does not apply.

    quantity: what was measured, such as "psnr"; value: NaN where it could not be; condition: under what, such as
    "random_pruning" or "photos"; severity: how strong the condition was, in its own unit; seed: of what is random in
    it; view, split, message and method: as in ``metric_table.MetricRow``.
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
    """Writes the rows in their order, one JSON object a line, without the columns that do not apply."""
    writer.write_file(MEASUREMENTS_FILE, to_lines(rows))


def read_measurements(artifact: Artifact) -> tuple[Measurement, ...]:
    """The rows of an artifact of kind ``measurements``, in the order written; empty if none were.

    Raises ``UserError`` with the file and line if a row is not one.
    """
    path = artifact.file(MEASUREMENTS_FILE)
    return from_lines(path.read_text(encoding="utf-8"), str(path))


def to_lines(rows: Iterable[Measurement]) -> str:
    """The rows as text, a line each."""
    return "".join(_to_line(row) for row in rows)


def from_lines(text: str, where: str) -> tuple[Measurement, ...]:
    """The rows of such a text; `where` is what it is called in the `UserError` that a line raises which is none."""
    return tuple(_from_line(line, f"{where}, line {number}") for number, line in enumerate(text.splitlines(), start=1))


def _to_line(row: Measurement) -> str:
    fields = {name: value for name, value in dataclasses.asdict(row).items() if value is not None}
    if not math.isfinite(row.value):  # JSON has neither; float() reads them back
        fields["value"] = str(row.value)
    return json.dumps(fields, allow_nan=False) + "\n"  # in ASCII: a name may hold what ends a line elsewhere


def _from_line(line: str, where: str) -> Measurement:
    try:
        fields = json.loads(line)
        return Measurement(**{**fields, "value": float(fields["value"])})
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            "a measurement cannot be read", where=where, found=line[:120], expected="a JSON object of Measurement"
        ) from error
