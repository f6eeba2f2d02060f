"""Figures of a found container: whose it is, and what was done to it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.analysis.measurements import read_measurements
from stages.analysis.verdicts import IS_YOURS, MAY_BE_YOURS


@dataclass(frozen=True)
class Found:
    """What the stage `recover` measured of a found container; without `is_yours` it may still be the owner's."""

    is_yours: bool
    mirrored: float
    degrees: float
    shift: float
    scale: float
    matched: float
    found_again: float
    feature_change: float
    gaussians_found: float
    gaussians_published: float


MEASURED = tuple(Found.__dataclass_fields__)[1:]


def read_found(figures: Iterable[Artifact]) -> tuple[Found, ...]:
    """One `Found` for each artifact of figures. Raises `UserError` for figures of another stage than `recover`."""
    return tuple(map(_read, figures))


def _read(artifact: Artifact) -> Found:
    figures = {row.quantity: row.value for row in read_measurements(artifact)}
    if not {IS_YOURS, MAY_BE_YOURS} & figures.keys() or not figures.keys() >= set(MEASURED):
        raise UserError(
            "figures that do not say whose container it is",
            where=str(artifact.path),
            found=", ".join(figures) or "none",
            expected=f"{IS_YOURS} or {MAY_BE_YOURS}, {', '.join(MEASURED)}",
            remedy="give the report the figures of a stage that uses recover",
        )
    return Found(IS_YOURS in figures, *(figures[name] for name in MEASURED))
