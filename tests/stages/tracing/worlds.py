"""Small worlds for tests, with pages of a few texels."""

from __future__ import annotations

import numpy as np

from stages.tracing.world import Builder, Material

PAGE = 16


def builder(seed: int = 0) -> Builder:
    return Builder(np.random.default_rng(seed))


def plain(build: Builder, color: tuple[float, float, float] = (0.5, 0.5, 0.5), **properties: float) -> Material:
    """A material of one colour."""
    return build.material(np.full((PAGE, PAGE, 3), color, np.float32), 1.0, **properties)
