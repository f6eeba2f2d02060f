"""Gaussian noise on one kind of stored parameter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from stages.analysis.attacks.target import Target


def noise(names: Sequence[str]) -> Callable[[Target, float, torch.Generator], Target]:
    """An attack that adds noise to the named parameters; without names, to all attributes (features or harmonics).

    It adds sigma · randn to the stored, unactivated values, where sigma is the severity times the standard deviation
    of a column over all Gaussians: noise of severity 0.1 is a tenth of the values' spread, whatever their unit. (Other
    published code adds sigma² · randn, which is far less noise for the same number.) Quaternions are normalised first.
    The attacker knows only the container.
    """

    def attack(target: Target, severity: float, generator: torch.Generator) -> Target:
        attacked = sorted(names or target.gaussians.attributes)
        return target.with_parameters(
            {name: _noisy(_unit(name, target.gaussians[name]), severity, generator) for name in attacked}
        )

    return attack


def _noisy(values: Tensor, severity: float, generator: torch.Generator) -> Tensor:
    if not values.numel():  # `sh_rest` is empty for harmonics of degree 0; torch would warn about its deviation
        return values
    spread = values.std(dim=0, correction=0, keepdim=True)
    return values + severity * spread * torch.randn(values.shape, generator=generator)


def _unit(name: str, values: Tensor) -> Tensor:
    return torch.nn.functional.normalize(values, dim=-1) if name == "quats" else values
