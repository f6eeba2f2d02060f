"""Values averaged while a training ends: Gaussians and networks as on the way, not where the last view left them.

Every step follows one view, so that the last ones pull each parameter to and fro. An exponential average of the end of
the way (Polyak and Juditsky, 1992) leaves most of that out.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from stages.hiding.method import Method
from stages.scene.gaussians import Gaussians

AVERAGED_SHARE = 0.2
"""Of the iterations, the last: density control has ended long before, so that rows stay what they are."""


class Averages:
    """`values` by name, empty until the first iteration that counts; `decay` is the weight of what was before."""

    def __init__(self, decay: float, iterations: int):
        self.decay = decay
        self.first = iterations - int(AVERAGED_SHARE * iterations)
        self.values: dict[str, Tensor] = {}

    @torch.no_grad()
    def add(self, iteration: int, gaussians: Gaussians, method: Method) -> None:
        """Take in the values after this iteration, if it counts. With a decay of 0 nothing is averaged."""
        if self.decay == 0 or iteration < self.first:
            return
        for name, value in _values(gaussians, method).items():
            if name in self.values:
                self.values[name].lerp_(value, 1 - self.decay)
            else:
                self.values[name] = value.detach().clone()

    @torch.no_grad()
    def apply(self, gaussians: Gaussians, method: Method) -> None:
        """Put the averages in the place of the values; without any, all stays as it is."""
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
