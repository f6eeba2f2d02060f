"""Rows of measured figures, which the stages write and the report tabulates."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError

ROWS_FILE = "rows.jsonl"


@dataclass(frozen=True)
class MetricRow:
    """One measured figure. A column that does not apply is ``None``.

    view: the picture's name; split: "train" or "test"; message: the message's name, None for the cover (rows with a
    message are private); quantity and unit: see `imaging/quantities.py`; value: NaN if it could not be measured;
    iteration: for curves, the training step after which it was measured; method: what produced the picture ("plain",
    "gs_hider", …), which selects the figure's row in a table.
    """

    quantity: str
    value: float
    unit: str = ""
    view: str | None = None
    split: str | None = None
    message: str | None = None
    iteration: int | None = None
    method: str | None = None


def write_rows(writer: ArtifactWriter, rows: Iterable[MetricRow]) -> None:
    """Writes the rows in order to the artifact's file ``rows.jsonl``, one JSON object per line."""
    writer.write_file(ROWS_FILE, "".join(_to_line(row) for row in rows))


def read_rows(artifact: Artifact) -> tuple[MetricRow, ...]:
    """The rows of a ``metrics`` artifact, in the order written; empty if there are none.

    Raises ``UserError`` with the file and line if a row is malformed.
    """
    path = artifact.file(ROWS_FILE)
    lines = path.read_text(encoding="utf-8").splitlines()
    return tuple(_from_line(line, f"{path}, line {number}") for number, line in enumerate(lines, start=1))


def _to_line(row: MetricRow) -> str:
    fields = dataclasses.asdict(row)
    for column in ("iteration", "method"):
        if fields[column] is None:
            del fields[column]
    if math.isnan(row.value):
        fields["value"] = None
    elif math.isinf(row.value):  # JSON has no infinity; float() reads this back
        fields["value"] = str(row.value)
    return json.dumps(fields, allow_nan=False) + "\n"  # ASCII, as names may hold U+2028, at which splitlines() splits


def _from_line(line: str, where: str) -> MetricRow:
    try:
        fields = json.loads(line)
        fields["value"] = math.nan if fields["value"] is None else float(fields["value"])
        return MetricRow(**fields)
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            "a row of figures cannot be read", where=where, found=line[:120], expected="a JSON object of MetricRow"
        ) from error


def mean_value(rows: Sequence[MetricRow]) -> float:
    """The mean of the measured values; NaN if there are none."""
    return mean_of_known(row.value for row in rows)


def mean_of_known(values: Iterable[float]) -> float:
    """The mean of the values that are not NaN; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan
