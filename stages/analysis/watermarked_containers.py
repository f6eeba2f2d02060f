"""Attacks by thieves on a watermarked container before they show renders of it."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from stages.analysis.attacks.noise import noise
from stages.analysis.attacks.pruning import random_pruning
from stages.analysis.attacks.quantisation import quantisation
from stages.analysis.attacks.target import Target
from stages.analysis.watermark_trials import NOISE, PRUNING, QUANTISATION


def attacked_containers(target: Target, seed: int) -> Iterator[tuple[str, float, Target]]:
    """Attacked containers, each with its attack's name and severity. The stage `attack` measures the cover's loss."""

    def generator() -> torch.Generator:
        return torch.Generator().manual_seed(seed)

    for share in (0.05, 0.25):
        yield PRUNING, share, random_pruning(target, share, generator())
    for bits in (8, 5):
        yield QUANTISATION, bits, quantisation(target, bits)
    for spread in (0.1, 0.2):
        yield NOISE, spread, noise([])(target, spread, generator())
