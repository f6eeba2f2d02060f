"""Saving and restoring Adam's state of each parameter in checkpoints."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from stages.training.adam import Adam


def moments_of(adam: Adam | None, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Both moments and the step count of every parameter that has taken a step, under the parameter's name.

    Empty without an Adam.
    """
    return {
        f"{name}/{moment}": tensor
        for name, parameter in parameters.items()
        if adam is not None
        for moment, tensor in adam.state.get(parameter, {}).items()
    }


def set_moments(adam: Adam | None, parameters: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    """Make Adam continue with copies of what `moments_of` returned; `tensors` may hold others as well."""
    for name, parameter in parameters.items():
        found = {key.rpartition("/")[2]: tensor for key, tensor in tensors.items() if key.rpartition("/")[0] == name}
        if adam is not None and found:
            adam.state[parameter] = {moment: _laid_out_as(parameter, tensor) for moment, tensor in found.items()}


def _laid_out_as(parameter: Tensor, tensor: Tensor) -> Tensor:
    """A copy of Adam's state on the parameter's device and in its memory layout, as Adam creates it.

    The step count has no layout; fused Adam needs it on that device, too.
    """
    if tensor.shape != parameter.shape:
        return tensor.to(parameter.device, copy=True)
    return torch.empty_like(parameter, requires_grad=False).copy_(tensor)
