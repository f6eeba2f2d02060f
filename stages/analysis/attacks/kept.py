"""What an interrupted stage has measured is kept in its scratch folder: it goes on with the next attack."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from stages.analysis.measurements import Measurement, from_lines, to_lines


def kept(folder: Path, name: str, measure: Callable[[], Iterable[Measurement]]) -> tuple[Measurement, ...]:
    """The rows that `measure` gives, or gave before under this name: all of them, or it is measured again.

    The folder belongs to one action, so that rows of other parameters or inputs are never in it.
    """
    file = folder / f"{name}.jsonl"
    if file.is_file():
        return from_lines(file.read_text(encoding="utf-8"), str(file))
    rows = tuple(measure())
    unfinished = folder / f"{name}.unfinished"
    unfinished.write_text(to_lines(rows), encoding="utf-8")
    unfinished.replace(file)
    return rows
