"""Gaussian noise on one kind of parameter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from stages.analysis.attacks.target import Target


def noise(names: Sequence[str]) -> Callable[[Target, float, torch.Generator], Target]:
    """Noise on these stored parameters; on all attributes of the method, features or harmonics, for no names.

    The attack adds sigma · randn to stored, unactivated values, where sigma is the severity times the standard
    deviation of a column over all Gaussians: "noise of 0.1" is then a tenth of what values differ by, whatever their
    unit is. (Code of others that adds sigma² · randn calls the same number far less noise.) The attacker knows the
    container alone. Quaternions are normalised first.
    """

    def attack(target: Target, severity: float, generator: torch.Generator) -> Target:
        attacked = sorted(names or target.gaussians.attributes)
        return target.with_parameters(
            {name: _noisy(_unit(name, target.gaussians[name]), severity, generator) for name in attacked}
        )

    return attack


def _noisy(values: Tensor, severity: float, generator: torch.Generator) -> Tensor:
    if not values.numel():  # harmonics of degree 0 have none beside the constant; torch warns of their spread
        return values
    spread = values.std(dim=0, correction=0, keepdim=True)
    return values + severity * spread * torch.randn(values.shape, generator=generator)


def _unit(name: str, values: Tensor) -> Tensor:
    return torch.nn.functional.normalize(values, dim=-1) if name == "quats" else values
