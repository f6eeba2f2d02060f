"""What an interrupted stage has measured is kept in its scratch folder: it goes on with the next attack."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from pipeline.disk import flush
from pipeline.sealed import read_sealed, sealed
from stages.analysis.measurements import Measurement, from_lines, to_lines

ROWS = "rows"


def kept(folder: Path, name: str, measure: Callable[[], Iterable[Measurement]]) -> tuple[Measurement, ...]:
    """The rows that `measure` gives, or gave before under this name: all of them, or it is measured again.

    The folder belongs to one action, so that rows of other parameters or inputs are never in it. What a power cut has
    left damaged is measured again.
    """
    file = folder / f"{name}.json"
    found = read_sealed(file)
    if found is not None:
        return from_lines(found[ROWS], str(file))
    rows = tuple(measure())
    unfinished = folder / f"{name}.unfinished"
    unfinished.write_text(sealed({ROWS: to_lines(rows)}), encoding="utf-8")
    flush(unfinished)
    unfinished.replace(file)
    flush(folder)
    return rows
