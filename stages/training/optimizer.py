"""Adam over a changing number of Gaussians: rows of parameters and of their moments are rearranged together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import torch
from jaxtyping import Int
from torch import Tensor

from stages.scene.gaussians import Gaussians
from stages.training.adam import Adam

EPSILON = 1e-15
"""3DGS's value: its gradients are far smaller than Adam's default epsilon is suited to."""

MOMENTS = ("exp_avg", "exp_avg_sq")


class GaussianOptimizer:
    """One Adam group per parameter, with a learning rate of its own.

    Raises `ValueError` unless each parameter has exactly one learning rate.
    """

    def __init__(self, gaussians: Gaussians, learning_rates: Mapping[str, float]):
        missing = set(gaussians.parameters) ^ set(learning_rates)
        if missing:
            raise ValueError(f"each parameter needs exactly one learning rate; unmatched: {sorted(missing)}")
        self.gaussians = gaussians
        for name, tensor in gaussians.parameters.items():
            gaussians.parameters[name] = tensor.detach().requires_grad_()
        self.adam = Adam(
            [
                {"params": [gaussians.parameters[name]], "lr": rate, "name": name}
                for name, rate in learning_rates.items()
            ],
            eps=EPSILON,
            fused=True,
        )

    def step(self) -> None:
        """Take one step of Adam and discard the gradients."""
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)

    def set_learning_rate(self, name: str, rate: float) -> None:
        """Set a parameter's learning rate from the next step on."""
        self._group(name)["lr"] = rate

    def rearrange(self, kept: Int[Tensor, " K"], added: Mapping[str, Tensor]) -> None:
        """Keep the rows `kept`, in that order, then append the rows `added` (the same count for every parameter).

        Kept rows keep their moments; those of added rows are zero.
        """
        for name in list(self.gaussians.parameters):
            old = self.gaussians.parameters[name]
            new_rows = added[name].detach()
            self._replace(name, torch.cat([old.detach()[kept], new_rows]), partial(_extended, kept, len(new_rows)))

    def overwrite(self, name: str, values: Tensor) -> None:
        """Replace a parameter's values by a copy of `values` and set its moments to zero: 3DGS's opacity reset."""
        self._replace(name, values.detach().clone(), torch.zeros_like)

    def replace_all(self, values: Mapping[str, Tensor]) -> None:
        """Replace every parameter by a copy of its `values`, with any number of rows, and discard Adam's state."""
        for name in list(self.gaussians.parameters):
            self._replace(name, values[name].clone(), torch.zeros_like)
        self.adam.state.clear()

    def _replace(self, name: str, values: Tensor, transform: Callable[[Tensor], Tensor]) -> None:
        """Make `values`, which must not be shared, the parameter."""
        group = self._group(name)
        state = self.adam.state.pop(group["params"][0], None)
        parameter = values.requires_grad_()
        if state is not None:
            state.update({moment: transform(state[moment]) for moment in MOMENTS})
            self.adam.state[parameter] = state
        group["params"][0] = parameter
        self.gaussians.parameters[name] = parameter

    def _group(self, name: str) -> dict:
        return next(group for group in self.adam.param_groups if group["name"] == name)


def _extended(kept: Int[Tensor, " K"], added: int, moment: Tensor) -> Tensor:
    """The moments of the kept rows, then zeros for the added ones."""
    return torch.cat([moment[kept], moment.new_zeros(added, *moment.shape[1:])])
