"""Attacks by thieves on a watermarked container before they show renders of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from stages.analysis.attacks.noise import noise
from stages.analysis.attacks.pruning import random_pruning
from stages.analysis.attacks.quantisation import quantisation
from stages.analysis.attacks.target import Target
from stages.analysis.watermark_trials import CONTAINER_NOISE, PRUNING, QUANTISATION


def attacked_containers(target: Target, seed: int) -> list[tuple[str, float, Callable[[], Target]]]:
    """Each attack's name, its severity, and a function that makes the attacked container.

    The stage `attack` measures the cover's loss.
    """

    def generator() -> torch.Generator:
        return torch.Generator().manual_seed(seed)

    def pruned(share: float) -> Target:
        return random_pruning(target, share, generator())

    def quantised(bits: int) -> Target:
        return quantisation(target, bits)

    def noisy(spread: float) -> Target:
        return noise([])(target, spread, generator())

    return [
        *((PRUNING, share, partial(pruned, share)) for share in (0.05, 0.25)),
        *((QUANTISATION, bits, partial(quantised, bits)) for bits in (8, 5)),
        *((CONTAINER_NOISE, spread, partial(noisy, spread)) for spread in (0.1, 0.2)),
    ]
