"""Training a network on pictures: a watermark codec, or its decoder. Gaussians have a loop of their own.

A training resumed from a checkpoint gives the same bits as an uninterrupted one: what a step draws follows from the
seed and the number of the step, so that the state holds no generator.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from opencl.routes import working_device
from pipeline.checkpoint import Checkpoints, State
from pipeline.stage import Context
from stages.imaging.metric_table import MetricRow
from stages.training.adam import Adam
from stages.training.backward import in_one_thread
from stages.training.checkpoints import checkpoints_on
from stages.training.divergence import refuse_divergence
from stages.training.gpu_memory import too_large
from stages.training.moments import moments_of, set_moments
from stages.training.schedules import decayed
from stages.training.stretches import POINTS, decibels_of, stretch_of

LARGEST_GRADIENT = 1.0
"""Norm to which gradients are clipped, since the scales of couplings and of their inverses are exponentials."""


class NetworkTraining(ABC):
    """A training in progress. `weights` names the squared errors that a step computes, and their weights in the loss.

    Adam's learning rate decays exponentially from `rate` to `final_rate` over `iterations` steps; a parameter group's
    `share`, if any, multiplies it.
    """

    needs_less_memory: ClassVar[str] = "train on smaller pictures"
    """What to do if the GPU has too little memory, the end of a sentence."""

    def __init__(
        self, network: torch.nn.Module, weights: Mapping[str, float], iterations: int, rate: float, final_rate: float
    ):
        self.network, self.weights, self.iterations = network, weights, iterations
        self.rate, self.final_rate = rate, final_rate
        self.adam = Adam(self.parameter_groups(), lr=rate, fused=True)
        self.history: list[list[float]] = []

    @property
    def iteration(self) -> int:
        """The number of steps taken."""
        return len(self.history)

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Adam's parameter groups; each group's gradient is clipped separately."""
        return [{"params": list(self.network.parameters())}]

    def weighed(self, name: str, error: Float[Tensor, ""], progress: float) -> Float[Tensor, ""]:
        """The contribution of an error to the loss at `progress` in (0, 1] of the training.

        It must be linear in an error that `errors` gives in terms.
        """
        return self.weights[name] * error

    @abstractmethod
    def errors(self, iteration: int) -> Iterator[Mapping[str, Float[Tensor, ""]]]:
        """Yield the squared errors of one step, by the names of `weights`; `iteration` counts from 1.

        They come in groups that share no graph: a step lets go of the memory of one before it asks for the next. An
        error that comes in several groups is the sum of its terms.
        """

    def step(self) -> None:
        """Take one step. Raises `UserError` if an error is NaN or infinite."""
        iteration = self.iteration + 1
        progress = iteration / self.iterations
        rate = decayed(self.rate, self.final_rate, progress)
        for group in self.adam.param_groups:
            group["lr"] = rate * group.get("share", 1.0)
        errors: dict[str, Tensor] = {}
        for terms in map(partial(self._propagated, progress), self.errors(iteration)):  # a loop would keep a graph
            for name, term in terms.items():
                errors[name] = errors[name] + term if name in errors else term
        for group in self.adam.param_groups:
            torch.nn.utils.clip_grad_norm_(group["params"], LARGEST_GRADIENT)
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)
        self.history.append([float(errors[name]) for name in self.weights])
        refuse_divergence(sum(self.history[-1]), iteration)

    def _propagated(self, progress: float, errors: Mapping[str, Float[Tensor, ""]]) -> dict[str, Float[Tensor, ""]]:
        """Add the gradient of these errors to the parameters'; returns the errors without their graph."""
        with in_one_thread():
            torch.stack([self.weighed(name, error, progress) for name, error in errors.items()]).sum().backward()
        return {name: error.detach() for name, error in errors.items()}

    def decibels(self, first: int, last: int) -> dict[str, float]:
        """The PSNR in dB over steps `first` + 1 to `last`, at least one step, by the names of the errors."""
        means = np.mean(self.history[first:last], axis=0)
        return {name: decibels_of(mean) for name, mean in zip(self.weights, means, strict=True)}

    def curves(self) -> list[MetricRow]:
        """About a hundred points of each error's curve, as PSNR; the error's name is in the column `method`."""
        every = stretch_of(self.iterations)
        return [
            MetricRow("psnr", value, "dB", split="train", iteration=last, method=name)
            for last in range(every, self.iteration + 1, every)
            for name, value in self.decibels(last - every, last).items()
        ]

    def state(self) -> State:
        """Everything that changes. Arrays may share memory with the training: save them before the next step."""
        tensors = {f"weights/{name}": tensor for name, tensor in self.network.state_dict().items()}
        tensors |= moments_of(self.adam, self._learnt())
        arrays = {name: tensor.detach().contiguous().cpu().numpy() for name, tensor in tensors.items()}
        return State({**arrays, "history": np.array(self.history, float).reshape(-1, len(self.weights))}, {})

    def set_state(self, state: State) -> None:
        """Continue from the state of a training with the same inputs and settings, on the network's device."""
        arrays = dict(state.arrays)
        self.history = arrays.pop("history").tolist()
        tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
        self.network.load_state_dict({name: tensors[f"weights/{name}"] for name in self.network.state_dict()})
        set_moments(self.adam, self._learnt(), tensors)

    def _learnt(self) -> dict[str, Tensor]:
        return {f"moments/{name}": parameter for name, parameter in self.network.named_parameters()}


def train_network(context: Context, training: NetworkTraining) -> list[MetricRow]:
    """Take all remaining steps, from the newest checkpoint if there is one; returns the curves of all steps.

    Raises `Interrupted` when the engine asks to stop, after saving a checkpoint, and `UserError` if the GPU has too
    little memory.
    """
    try:
        return _train(context, training)
    except torch.OutOfMemoryError as error:
        raise too_large(error, f"step {training.iteration + 1}", remedy=training.needs_less_memory) from error


def _train(context: Context, training: NetworkTraining) -> list[MetricRow]:
    checkpoints = checkpoints_on(context, working_device())
    _go_on(context, training, checkpoints)
    while training.iteration < training.iterations:
        training.step()
        last = training.iteration
        context.progress(last, training.iterations, **training.decibels(max(0, last - POINTS), last))
        checkpoints.save_or_stop(training.state, f"stopped after step {last} of {training.iterations}")
    return training.curves()


def _go_on(context: Context, training: NetworkTraining, checkpoints: Checkpoints) -> None:
    """Resume from the newest checkpoint, if there is one; its arrays are let go on return."""
    found = checkpoints.newest()
    if found is not None:
        training.set_state(found.state)
        context.log(f"goes on from step {training.iteration} of {training.iterations}")
