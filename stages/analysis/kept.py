"""What an interrupted stage has measured is kept in its scratch folder: it goes on with what is next."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from pipeline.artifact import create, load
from pipeline.errors import CorruptArtifact
from stages.analysis.measurements import KIND, Measurement, read_measurements, write_measurements


def kept(folder: Path, name: str, measure: Callable[[], Iterable[Measurement]]) -> tuple[Measurement, ...]:
    """The rows that `measure` gives, or gave before under this name: all of them, or it is measured again.

    The folder belongs to one action, so that rows of other parameters or inputs are never in it. What a power cut has
    left damaged is measured again.
    """
    place = folder / name
    with suppress(CorruptArtifact):
        return read_measurements(load(place))
    shutil.rmtree(place, ignore_errors=True)
    rows = tuple(measure())
    with create(place, KIND, private=True) as writer:
        write_measurements(writer, rows)
    return rows
