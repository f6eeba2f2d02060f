"""Averaging Gaussians and networks over the end of a training, instead of keeping what the last view left.

Every step follows one view, so that the last ones pull each parameter back and forth. An exponential average of the
last iterations (Polyak and Juditsky, 1992) removes most of that.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from stages.hiding.method import Method
from stages.scene.gaussians import Gaussians

AVERAGED_SHARE = 0.2
"""Share of the iterations, at the end, that is averaged: density control has stopped long before, so that rows
correspond."""


class Averages:
    """The averages, `values`, by name; empty until the first averaged iteration. `decay` is the weight of the past."""

    def __init__(self, decay: float, iterations: int):
        self.decay = decay
        self.first = iterations - int(AVERAGED_SHARE * iterations)
        self.values: dict[str, Tensor] = {}

    @torch.no_grad()
    def add(self, iteration: int, gaussians: Gaussians, method: Method) -> None:
        """Include the values after this iteration, if it is averaged. With a decay of 0, nothing is averaged."""
        if self.decay == 0 or iteration < self.first:
            return
        for name, value in _values(gaussians, method).items():
            if name in self.values:
                self.values[name].lerp_(value, 1 - self.decay)
            else:
                self.values[name] = value.detach().clone()

    @torch.no_grad()
    def apply(self, gaussians: Gaussians, method: Method) -> None:
        """Replace the values by their averages; without averages, nothing changes."""
        for name, value in _values(gaussians, method).items():
            if name in self.values:
                value.copy_(self.values[name])


def _values(gaussians: Gaussians, method: Method) -> Mapping[str, Tensor]:
    networks = {
        f"networks/{network}/{weight}": tensor
        for network, module in method.networks.items()
        for weight, tensor in module.state_dict().items()
    }
    return {f"gaussians/{name}": tensor for name, tensor in gaussians.parameters.items()} | networks
