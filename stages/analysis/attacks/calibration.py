"""Bisection for the severities at which an attack does a given damage."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

SMALLEST_SHARE = 1e-4
"""The weakest severity that is tried, as a share of the strongest."""

STEPS = 8
TOLERANCE = 0.08
"""Bisection stops at a severity whose damage is within this share of the aim."""


def calibrated(damage: Callable[[float], float], aims: Sequence[float], strongest: float) -> tuple[float, ...]:
    """The severities at which the damage comes closest to each of `aims`, ascending and positive.

    The first aim that `strongest` does not exceed gets `strongest`; larger aims get no severity.

    Damage is assumed to grow with severity, more or less. The bisection runs on a logarithmic scale, since what one
    attack does at a millionth of its strongest severity, another does at half. Measurements for one aim narrow the
    search for the next. Damage of NaN, where pictures can no longer be rendered, counts as larger than every aim.
    """
    looked_at: dict[float, float] = {}

    def at(severity: float) -> float:
        if severity not in looked_at:
            done = damage(severity)
            looked_at[severity] = math.inf if math.isnan(done) else done
        return looked_at[severity]

    found: list[float] = []
    for aim in sorted(aims):
        if at(strongest) <= aim:
            found.append(strongest)
            break
        found.append(_nearest(at, looked_at, aim, SMALLEST_SHARE * strongest))
    return tuple(sorted(set(found)))


def _nearest(at: Callable[[float], float], looked_at: dict[float, float], aim: float, smallest: float) -> float:
    above = min(severity for severity, value in looked_at.items() if value > aim)
    below = max((severity for severity, value in looked_at.items() if severity < above), default=smallest)
    for _ in range(STEPS):
        middle = math.sqrt(below * above)
        value = at(middle)
        if abs(value - aim) <= TOLERANCE * aim:
            return middle
        below, above = (middle, above) if value < aim else (below, middle)
    return min((below, above), key=lambda severity: abs(at(severity) - aim))
