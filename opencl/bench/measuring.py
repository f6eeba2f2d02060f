"""Measures time and memory of an implementation on a workload, end to end from torch tensors to torch tensors."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from opencl.bench.implementations import Implementation, implementation_named
from opencl.bench.processes import current_memory, in_fresh_process, peak_memory
from opencl.bench.workloads import Inputs, Workload

_WARM_UPS = 2
_LONG_ENOUGH = 20.0
"""A slow implementation is not called again after this many seconds, warm-ups included."""


@dataclass(frozen=True)
class Times:
    """Median times per picture, over `calls` calls."""

    seconds: float
    processor_seconds: float
    """CPU time summed over all processors, which other work on the machine disturbs less."""
    calls: int


@dataclass(frozen=True)
class Memory:
    """Peak host memory of the process in bytes, beyond imports and inputs, up to the end of each pass. Memory of the
    device's own is not included."""

    forward: int
    forward_backward: int


@dataclass(frozen=True)
class Measurement:
    """Results of an implementation on a workload."""

    implementation: str
    feature_dim: int
    """Number of features drawn: fewer than the workload has if the implementation cannot draw them all."""
    forward: Times
    forward_backward: Times
    memory: Memory


def measure(implementation: Implementation, workload: Workload, repetitions: int) -> Measurement:
    """Measure in two fresh processes, one for times and one for memory. Raises RuntimeError if either fails."""
    arguments = (implementation.name, workload)
    feature_dim, forward, both = in_fresh_process(_measure_times, *arguments, repetitions)
    memory = in_fresh_process(_measure_memory, *arguments)
    return Measurement(implementation.name, feature_dim, forward, both, memory)


class _Drawing:
    """Draws all views of a workload in turn with an implementation."""

    def __init__(self, name: str, workload: Workload) -> None:
        self._implementation = implementation_named(name)
        channels = self._implementation.channels
        inputs = workload.inputs()
        self.inputs: Inputs = inputs if channels is None else inputs.with_features(channels)
        self._leaves = [tensor.clone().requires_grad_() for tensor in self.inputs.trained]
        view = self.inputs.views[0]
        self._gradient = torch.rand(view.height, view.width, self.inputs.features.shape[1])

    def forward(self) -> None:
        with torch.no_grad():
            for view in self.inputs.views:
                self._draw(self.inputs.trained, *view.arguments)

    def forward_backward(self) -> None:
        for view in self.inputs.views:
            self._draw(self._leaves, *view.arguments).backward(self._gradient)
            for leaf in self._leaves:
                leaf.grad = None  # as in training: accumulating would cost another pass over memory

    def _draw(self, gaussians: list[Tensor] | tuple[Tensor, ...], *camera: Tensor | int) -> Tensor:
        settings = self._implementation.settings
        return self._implementation.draw(*gaussians, *camera, settings=settings).features


def _measure_times(name: str, workload: Workload, repetitions: int) -> tuple[int, Times, Times]:
    drawing = _Drawing(name, workload)
    views = len(drawing.inputs.views)
    feature_dim = drawing.inputs.features.shape[1]
    forward, both = (_medians(work, views, repetitions) for work in (drawing.forward, drawing.forward_backward))
    return feature_dim, forward, both


def _medians(work: Callable[[], object], pictures: int, repetitions: int) -> Times:
    clock: list[float] = []
    processors: list[float] = []
    for call in range(_WARM_UPS + repetitions):
        if call > _WARM_UPS and sum(clock) > _LONG_ENOUGH:
            break
        start, start_processors = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - start)
        processors.append(time.process_time() - start_processors)
    kept = slice(_WARM_UPS, None)
    return Times(
        seconds=statistics.median(clock[kept]) / pictures,
        processor_seconds=statistics.median(processors[kept]) / pictures,
        calls=len(clock[kept]),
    )


def _measure_memory(name: str, workload: Workload) -> Memory:
    drawing = _Drawing(name, workload)
    before = current_memory()
    drawing.forward()
    forward = peak_memory() - before
    drawing.forward_backward()
    return Memory(forward, peak_memory() - before)
