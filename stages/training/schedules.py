"""Schedules of a training: fractions of its iterations that equal 3DGS's numbers at 30,000 iterations."""

from __future__ import annotations

import math
from dataclasses import dataclass

REFERENCE_ITERATIONS = 30_000
SHORTEST_INTERVAL = 50

SHORTEST_RESET_INTERVAL = 1_500
"""Opacities recover from a reset within 500 iterations, and the picture takes longer: a reset every 600 iterations cost
plain 3DGS 0.5 dB on bonsai, and next to nothing on the fox and kitchen (workflows/figures/relations.md)."""


@dataclass(frozen=True)
class DensitySchedule:
    """Iterations at which Gaussians are added, removed and made transparent again."""

    start: int
    stop: int
    interval: int
    opacity_reset_interval: int

    def densifies_at(self, iteration: int) -> bool:
        """Whether Gaussians are cloned, split and pruned after this iteration (counted from 1)."""
        return self.start < iteration <= self.stop and iteration % self.interval == 0

    def resets_opacity_at(self, iteration: int) -> bool:
        """Whether opacities are lowered after this iteration (counted from 1)."""
        return iteration < self.stop and iteration % self.opacity_reset_interval == 0


def density_schedule(iterations: int, opacity_resets: bool = True) -> DensitySchedule:
    """3DGS's schedule (500 to 15,000 every 100, reset every 3,000), scaled from 30,000 to `iterations`.

    Deviations: Gaussians are refined once more, at 15,000 itself, where 3DGS ends at 14,900; the interval is at least
    50, since a mean gradient over a handful of views says nothing; and a run of under 15,000 iterations, in which
    opacity resets would follow each other too soon, has none at all.

    Without `opacity_resets`, there are none either. Overgrown Gaussians, which are only pruned after the first reset,
    then stay.
    """
    scale = iterations / REFERENCE_ITERATIONS
    reset = round(3_000 * scale)
    return DensitySchedule(
        start=round(500 * scale),
        stop=round(15_000 * scale),
        interval=max(SHORTEST_INTERVAL, round(100 * scale)),
        opacity_reset_interval=reset if opacity_resets and reset >= SHORTEST_RESET_INTERVAL else iterations + 1,
    )


def decayed(initial: float, final: float, progress: float) -> float:
    """Decay exponentially from `initial` to `final` for `progress` from 0 to 1, like 3DGS's position learning rate."""
    share = min(max(progress, 0.0), 1.0)
    return math.exp((1 - share) * math.log(initial) + share * math.log(final))
