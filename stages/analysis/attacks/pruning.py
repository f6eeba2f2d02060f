"""Pruning as in the paper's table of robustness, and cropping and cloning, which take and give whole Gaussians too."""

from __future__ import annotations

import torch

from stages.analysis.attacks.target import Target


def sequential_pruning(target: Target, share: float) -> Target:
    """Prune this share of the Gaussians "in ascending order of Gaussian's opacity" (Property Study #3 of the paper).

    The attacker knows the container alone. Equal opacities go in the order of their rows.
    """
    order = target.gaussians["logit_opacities"].argsort(stable=True)
    return target.keeping(order[_count(target, share) :].sort().values)


def random_pruning(target: Target, share: float, generator: torch.Generator) -> Target:
    """Prune this share of the Gaussians at random, as in the paper. The attacker knows the container alone."""
    order = torch.randperm(len(target.gaussians), generator=generator)
    return target.keeping(order[_count(target, share) :].sort().values)


def cropping(target: Target, share: float, generator: torch.Generator) -> Target:
    """Crop out this share of the Gaussians: the nearest to one of them, drawn at random, by their means.

    The attacker knows the container alone. Watermarks of 3DGS are tested with a part of the scene cropped out
    (GuardSplat, 3D-GSW); here the part is a ball.
    """
    count = len(target.gaussians)
    centre = target.gaussians.means[torch.randint(count, (1,), generator=generator)] if count else torch.zeros(1, 3)
    distances = (target.gaussians.means - centre).square().sum(dim=1)
    return target.keeping(distances.argsort(stable=True)[_count(target, share) :].sort().values)


def cloning(target: Target, share: float, generator: torch.Generator) -> Target:
    """Double this share of the Gaussians, at random, where they are: what they blend becomes more opaque.

    The attacker knows the container alone. A distortion of 3D-GSW and GuardSplat.
    """
    chosen = torch.randperm(len(target.gaussians), generator=generator)[: _count(target, share)]
    return target.keeping(torch.cat([torch.arange(len(target.gaussians)), chosen]))


def _count(target: Target, share: float) -> int:
    return round(share * len(target.gaussians))
