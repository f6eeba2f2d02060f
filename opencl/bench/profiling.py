"""Profiles the kernels of a picture by the device's own clock."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.bench.counts import Counts, count_work
from opencl.bench.implementations import OURS
from opencl.bench.view import View
from opencl.bench.workloads import Workload
from opencl.device import choose_device
from opencl.rasterizer import _rasterize_on

_WARM_UPS = 2


@dataclass(frozen=True)
class Profile:
    """Median times of one picture, forward and backward."""

    counts: Counts
    kernels: dict[str, float]
    """Total seconds of each kernel's launches, in order of first launch."""
    seconds: float
    """Wall-clock seconds, including time outside kernels. Profiling makes them slightly longer."""


def profile(workload: Workload, repetitions: int) -> Profile:
    """Profile our rasterizer on a workload. Call it in a fresh process."""
    backend = Backend(choose_device(), profile=True)
    inputs = workload.inputs()
    view = inputs.views[0]
    leaves = [tensor.clone().requires_grad_() for tensor in inputs.trained]
    gradient = torch.rand(view.height, view.width, inputs.features.shape[1])
    passes: list[dict[str, float]] = []
    clock: list[float] = []
    for _ in range(_WARM_UPS + repetitions):
        assert backend.profiled is not None
        backend.profiled.clear()
        start = time.perf_counter()
        for view in inputs.views:
            _forward_backward(backend, leaves, view, gradient)
        clock.append((time.perf_counter() - start) / len(inputs.views))
        passes.append(_seconds_of_kernels(backend, len(inputs.views)))
    kept = passes[_WARM_UPS:]
    kernels = {name: statistics.median(one[name] for one in kept) for name in kept[0]}
    counts = count_work(backend, inputs, OURS.settings)
    return Profile(counts, kernels, statistics.median(clock[_WARM_UPS:]))


def _forward_backward(backend: Backend, leaves: Sequence[Tensor], view: View, gradient: Tensor) -> None:
    means, quats, scales, opacities, features = leaves
    gaussians = (means, quats, scales, opacities, features)
    background = torch.zeros(features.shape[1])
    _rasterize_on(backend, *gaussians, *view.arguments, background, OURS.settings).features.backward(gradient)
    for leaf in leaves:
        leaf.grad = None


def _seconds_of_kernels(backend: Backend, pictures: int) -> dict[str, float]:
    seconds: dict[str, float] = defaultdict(float)
    for kernel, event in backend.profiled or ():
        seconds[kernel] += (event.profile.end - event.profile.start) * 1e-9 / pictures
    return dict(seconds)
