"""Bisection for the severities at which an attack does a given damage."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

LEAST_LOSS = 0.05
"""In dB: a loss of the cover up to this counts as none."""

SAME = 1.01
"""Severities within this factor of each other, as on either side of a jump, are measured once, at the larger."""

SMALLEST_SHARE = 1e-4
"""The weakest severity that is tried, as a share of the strongest."""

STEPS = 8
TOLERANCE = 0.08
"""Bisection stops at a severity whose damage is within this share of the aim."""


def calibrated(damage: Callable[[float], float], aims: Sequence[float], strongest: float) -> tuple[float, ...]:
    """The severities at which the damage comes closest to each of `aims`, ascending and positive.

    If `strongest` does less than the largest aims, they give way to what it does and to smaller aims, as by `_reached`,
    so that the curve has as many points. There are fewer where damage jumps, and where the weakest severity that is
    tried does more than an aim. If `strongest` does no more than `LEAST_LOSS`, there is no other.

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

    most = at(strongest)
    if most <= LEAST_LOSS:
        return (strongest,)
    found = {_nearest(at, looked_at, aim, SMALLEST_SHARE * strongest) for aim in _reached(aims, most) if aim < most}
    ascending = sorted(found | {strongest} if most <= max(aims) else found)
    return tuple(each for each, above in pairwise([*ascending, math.inf]) if above > SAME * each)


def _reached(aims: Sequence[float], most: float) -> list[float]:
    """As many aims as given, ascending: those below `most` or, if these are not all, also `most` and filled gaps.

    What is filled is the middle of the widest gap between neighbours or below the first, again and again.
    """
    found = sorted(aim for aim in aims if aim < most)
    if len(found) < len(aims):
        found.append(most)
    while len(found) < len(aims):
        below, above = max(pairwise([0.0, *found]), key=lambda pair: pair[1] - pair[0])
        found = sorted([*found, (below + above) / 2])
    return found


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
