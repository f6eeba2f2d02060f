"""Evenly spread samples of many views."""

from __future__ import annotations

import numpy as np


def evenly_spread(total: int, wanted: int) -> list[int]:
    """At most `wanted` positions out of `total`, evenly spread from first to last; empty if either is not positive.

    >>> evenly_spread(10, 4), evenly_spread(3, 4), evenly_spread(0, 4), evenly_spread(10, -1)
    ([0, 3, 6, 9], [0, 1, 2], [], [])
    """
    positions: list[int] = np.linspace(0, total - 1, max(0, min(total, wanted))).round().astype(int).tolist()
    return positions
