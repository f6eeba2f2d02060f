"""What Adam remembers of each parameter, in a checkpoint and taken from one."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from stages.training.adam import Adam


def moments_of(adam: Adam | None, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Both moments and the count of steps of every parameter that has taken one, under the parameter's name.

    Without an Adam there are none.
    """
    return {
        f"{name}/{moment}": tensor
        for name, parameter in parameters.items()
        if adam is not None
        for moment, tensor in adam.state.get(parameter, {}).items()
    }


def set_moments(adam: Adam | None, parameters: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    """Has Adam go on with copies of what `moments_of` gave; other tensors may lie among these."""
    for name, parameter in parameters.items():
        found = {key.rpartition("/")[2]: tensor for key, tensor in tensors.items() if key.rpartition("/")[0] == name}
        if adam is not None and found:
            adam.state[parameter] = {moment: _laid_out_as(parameter, tensor) for moment, tensor in found.items()}


def _laid_out_as(parameter: Tensor, tensor: Tensor) -> Tensor:
    """A copy on the parameter's device and with its layout in memory, as Adam makes its moments; the count of steps,
    which fused Adam wants there, too, has no layout."""
    if tensor.shape != parameter.shape:
        return tensor.to(parameter.device, copy=True)
    return torch.empty_like(parameter, requires_grad=False).copy_(tensor)
