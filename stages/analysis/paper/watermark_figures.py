"""Figures from measurements of watermarks: titles of containers and decoders, and means by capture."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from stages.analysis.measurements import Measurement
from stages.analysis.page.figures import MISSING
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.grid import Cell
from stages.analysis.paper.measuring import Measured, Spread, mean
from stages.analysis.paper.runs import Experiment
from stages.analysis.watermark_trials import PSNR_WATERMARK

PAPERS, GRAINED, IMPRINTED = "paper", "grain", "imprint"
VARIANTS = {
    PAPERS: "RTWS",
    "clean": "RTWS, clean renders also black",
    IMPRINTED: "imprint",
    GRAINED: "grain, read by its owner",
}
"""How a container and its decoder were made, by the items' column `variant`, or by the name of their stage."""

STAGES = {"_imprint": IMPRINTED, "_grain": GRAINED}
"""Endings of the names of stages that score our own variants, for which one container serves all rows of a capture."""

Key = tuple[str, str]
"""Method and variant."""

EXACT = 99.0
"""The PSNR, in dB, that stands for an exactly shown watermark: infinity has no mean."""


def variant_of(stage: str, stated: str) -> str:
    """The variant that the stage's name implies, or else the one that its item states."""
    name = stage.split("[")[0]
    return next((variant for ending, variant in STAGES.items() if name.endswith(ending)), stated)


def title_of_key(key: Key) -> str:
    """The title of a method and variant in tables."""
    method, variant = key
    return f"{title_of(method)}, {VARIANTS.get(variant, variant)}"


def value_of(rows: Iterable[Measurement], quantity: str, condition: str, severity: float | None = None) -> float:
    """The mean over the matching rows, where PSNR_W counts as at most `EXACT`; NaN without any."""
    wanted = (quantity, condition, severity)
    values = [row.value for row in rows if (row.quantity, row.condition, row.severity) == wanted]
    return mean(min(value, EXACT) if quantity == PSNR_WATERMARK else value for value in values)


def percent_cell(share: float, note: str = "") -> Cell:
    """A share in percent; `MISSING` for NaN."""
    return Cell(MISSING if math.isnan(share) else f"{100 * share:.1f} %", note, Spread(share))


def captures_of(detections: Mapping[Key, Iterable[Experiment]]) -> tuple[str, ...]:
    """The captures that any watermark was tried on."""
    return tuple(dict.fromkeys(each.capture for group in detections.values() for each in group))


def figures_by_capture(
    detections: Iterable[Experiment], quantity: str, condition: str, severity: float | None = None
) -> Measured:
    """The mean over the experiments of each capture."""
    found: dict[str, list[float]] = {}
    for each in detections:
        value = value_of(each.rows, quantity, condition, severity)
        if not math.isnan(value):
            found.setdefault(each.capture, []).append(value)
    return Measured({capture: Spread(mean(values), count=len(values)) for capture, values in found.items()})
