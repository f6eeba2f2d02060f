"""Saving and restoring the whole state of a training: it then gives the same bits as without interruption.

The state excludes what follows from the stage's inputs and parameters, which are in the key of its action: the views,
the objective, the schedules (functions of the iteration) and the learning rates (set anew in every iteration). Nothing
may draw from the global generators of torch or NumPy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pipeline.checkpoint import State
from stages.hiding.message_names import LOSS
from stages.training.curves import Curves, Point
from stages.training.density_control import DensityControl
from stages.training.loop import Training
from stages.training.moments import moments_of, set_moments

Arrays = dict[str, np.ndarray]
STATISTICS = ("gradient_sums", "views_seen")


def state_of(training: Training) -> State:
    """The state between two iterations. Arrays may share memory with the training: save them before the next."""
    tensors: dict[str, Tensor] = {
        **{f"gaussians/{name}": tensor for name, tensor in training.gaussians.parameters.items()},
        **moments_of(training.optimizer.adam, _gaussian_parameters(training)),
        **{f"networks/{name}": tensor for name, tensor in _network_values(training)},
        **moments_of(training.network_optimizer, _network_parameters(training)),
        **{f"density/{name}": getattr(training.density, name) for name in STATISTICS if training.density is not None},
        **{f"averages/{name}": tensor for name, tensor in training.averages.values.items()},
        "generators/views": training.sampler.generator.get_state(),
        "generators/splitting": training.generator.get_state(),
    }
    arrays = {name: tensor.detach().contiguous().cpu().numpy() for name, tensor in tensors.items()}
    return State(
        arrays | _curve_arrays(training.curves),
        {
            "iteration": training.iteration,
            "remaining_views": list(training.sampler.remaining),
            "limited": training.density is not None and training.density.limited,
        },
    )


def set_state(training: Training, state: State) -> None:
    """Make a new training, created from the same inputs and parameters, continue from a state, on its own device."""
    values: Mapping[str, Any] = state.values
    tensors = {name: torch.from_numpy(array) for name, array in state.arrays.items()}
    training.iteration = values["iteration"]
    training.sampler.remaining = list(values["remaining_views"])
    training.sampler.generator.set_state(tensors["generators/views"].clone())
    training.generator.set_state(tensors["generators/splitting"].clone())
    training.optimizer.replace_all(
        {name: tensors[f"gaussians/{name}"].to(training.device) for name in training.gaussians.parameters}
    )
    set_moments(training.optimizer.adam, _gaussian_parameters(training), tensors)
    with torch.no_grad():
        for name, tensor in _network_values(training):
            tensor.copy_(tensors[f"networks/{name}"])  # in place, to preserve the memory layout
    set_moments(training.network_optimizer, _network_parameters(training), tensors)
    training.averages.values = {
        name.removeprefix("averages/"): tensor.to(training.device, copy=True)
        for name, tensor in tensors.items()
        if name.startswith("averages/")
    }
    _set_statistics(training.density, tensors)
    if training.density is not None:
        training.density.limited = values["limited"]
    _set_curves(training.curves, state.arrays)


def _gaussian_parameters(training: Training) -> dict[str, Tensor]:
    return {f"gaussian_moments/{name}": tensor for name, tensor in training.gaussians.parameters.items()}


def _network_parameters(training: Training) -> dict[str, Tensor]:
    return {
        f"network_moments/{name}/{parameter}": tensor
        for name, network in training.method.networks.items()
        for parameter, tensor in network.named_parameters()
    }


def _network_values(training: Training) -> Iterator[tuple[str, Tensor]]:
    """Yield parameters and buffers by name."""
    for name, network in training.method.networks.items():
        for value, tensor in network.state_dict().items():
            yield f"{name}/{value}", tensor


def _set_statistics(density: DensityControl | None, tensors: Mapping[str, Tensor]) -> None:
    for name in STATISTICS:
        if density is not None:
            setattr(density, name, tensors[f"density/{name}"].to(density.device, copy=True))


def _curve_arrays(curves: Curves) -> Arrays:
    """Points as rows of iteration and Gaussians, and of loss and decibels; and the figures since the last point."""
    columns = 1 + len(curves.pictures)
    figures = [[point.loss, *(point.decibels[name] for name in curves.pictures)] for point in curves.points]
    stretch = [[step[LOSS], *(step[name] for name in curves.pictures)] for step in curves.stretch]
    return {
        "curves/counts": np.array([[point.iteration, point.gaussians] for point in curves.points], int).reshape(-1, 2),
        "curves/figures": np.array(figures, float).reshape(-1, columns),
        "curves/stretch": np.array(stretch, float).reshape(-1, columns),
    }


def _set_curves(curves: Curves, arrays: Mapping[str, np.ndarray]) -> None:
    counts, figures = arrays["curves/counts"].tolist(), arrays["curves/figures"].tolist()
    curves.points = [
        Point(iteration, gaussians, loss, dict(zip(curves.pictures, decibels, strict=True)))
        for (iteration, gaussians), (loss, *decibels) in zip(counts, figures, strict=True)
    ]
    names = (LOSS, *curves.pictures)
    curves.stretch = [dict(zip(names, step, strict=True)) for step in arrays["curves/stretch"].tolist()]
