"""Measurements cached in a stage's scratch folder, so that an interrupted stage can resume."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from pipeline.artifact import create, load
from pipeline.errors import CorruptArtifact
from stages.analysis.measurements import KIND, Measurement, read_measurements, write_measurements


def kept(folder: Path, name: str, measure: Callable[[], Iterable[Measurement]]) -> tuple[Measurement, ...]:
    """The rows of `measure`, from the cache if they were completed before under this `name`.

    The folder belongs to one action, so it never holds rows for other parameters or inputs. Rows that a power cut has
    damaged are measured again.
    """
    place = folder / name
    with suppress(CorruptArtifact):
        return read_measurements(load(place))
    shutil.rmtree(place, ignore_errors=True)
    rows = tuple(measure())
    with create(place, KIND, private=True) as writer:
        write_measurements(writer, rows)
    return rows


def name_on(device: str, measured: bytes) -> str:
    """The name for rows of what is `measured` on a device, which `describe_drawing` describes: a hash of both.

    Devices round differently, so a stage that resumes on another one measures again.
    """
    return hashlib.sha256(device.encode() + b"\0" + measured).hexdigest()
