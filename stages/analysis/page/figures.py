"""How figures are written for people."""

from __future__ import annotations

import math

from stages.imaging.metric_table import QUANTITIES

MISSING = "–"


def label(quantity: str) -> str:
    """The heading of a quantity, with the unit that ``write_figure`` uses for it."""
    known = QUANTITIES.get(quantity)
    if known is None:
        return quantity.replace("_", " ")
    shown_unit = {"bytes": "MB", "s": "ms"}.get(known.unit, known.unit)
    return f"{known.label} ({shown_unit})" if shown_unit else known.label


def write_figure(quantity: str, value: float) -> str:
    """A value with the digits that mean something: decibels to 0.01, shares to 0.001, sizes in MB, times in ms.

    >>> write_figure("psnr", 27.1249), write_figure("container_bytes", 2_345_678), write_figure("ssim", math.nan)
    ('27.12', '2.35', '–')
    """
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    unit = QUANTITIES[quantity].unit if quantity in QUANTITIES else ""
    if unit == "bytes":
        return f"{value / 1e6:.2f}"
    if unit == "s":
        return f"{value * 1e3:.1f}"
    if quantity == "gaussians":
        return f"{round(value):,}"
    return f"{value:.2f}" if unit == "dB" else f"{value:.3f}"


def write_seconds(seconds: float) -> str:
    """A duration as people say it.

    >>> write_seconds(0.031), write_seconds(12.34), write_seconds(3725)
    ('0.03 s', '12.3 s', '1 h 2 min')
    """
    if seconds < 59.95:
        return f"{seconds:.2f} s" if seconds < 1 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
