"""Pruning as in the paper's robustness table, and cropping and cloning, which also remove or add whole Gaussians."""

from __future__ import annotations

import torch

from stages.analysis.attacks.target import Target


def sequential_pruning(target: Target, share: float) -> Target:
    """Prune this share of the Gaussians "in ascending order of Gaussian's opacity" (Property Study #3 of the paper).

    Gaussians of equal opacity are pruned in row order. The attacker knows only the container.
    """
    order = target.gaussians["logit_opacities"].argsort(stable=True)
    return target.keeping(order[_count(target, share) :].sort().values)


def random_pruning(target: Target, share: float, generator: torch.Generator) -> Target:
    """Prune this share of the Gaussians at random, as in the paper. The attacker knows only the container."""
    order = torch.randperm(len(target.gaussians), generator=generator)
    return target.keeping(order[_count(target, share) :].sort().values)


def cropping(target: Target, share: float, generator: torch.Generator) -> Target:
    """Crop out this share of the Gaussians: those whose means are nearest to that of a randomly drawn Gaussian.

    The attacker knows only the container. GuardSplat and 3D-GSW test watermarks of 3DGS with part of the scene cropped
    out; here that part is a ball.
    """
    count = len(target.gaussians)
    centre = target.gaussians.means[torch.randint(count, (1,), generator=generator)] if count else torch.zeros(1, 3)
    distances = (target.gaussians.means - centre).square().sum(dim=1)
    return target.keeping(distances.argsort(stable=True)[_count(target, share) :].sort().values)


def cloning(target: Target, share: float, generator: torch.Generator) -> Target:
    """Duplicate this share of the Gaussians, drawn at random, in place, which makes the scene more opaque there.

    The attacker knows only the container. 3D-GSW and GuardSplat use this distortion.
    """
    chosen = torch.randperm(len(target.gaussians), generator=generator)[: _count(target, share)]
    return target.keeping(torch.cat([torch.arange(len(target.gaussians)), chosen]))


def _count(target: Target, share: float) -> int:
    return round(share * len(target.gaussians))
