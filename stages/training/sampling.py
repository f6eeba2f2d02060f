"""Sampling of views: a new random order, from the seed, for every pass over the training views."""

from __future__ import annotations

import torch


class ViewSampler:
    """Samples views without replacement, pass after pass, as 3DGS does; the whole order follows from the seed."""

    def __init__(self, count: int, seed: int):
        self.count = count
        self.generator = torch.Generator().manual_seed(seed)
        self.remaining: list[int] = []

    def draw(self) -> int:
        """The next view, in 0..count-1."""
        if not self.remaining:
            self.remaining = torch.randperm(self.count, generator=self.generator).tolist()
        return self.remaining.pop()
