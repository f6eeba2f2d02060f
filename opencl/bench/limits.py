"""Measures the limits of a device: multiply-adds per second, and bytes per second from and to its memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyopencl

from opencl.backend import Backend
from opencl.device import choose_device

_KERNELS = Path(__file__).with_name("limits.cl")
_CHAINS = 12
"""Independent chains of multiply-adds per work-item, as in limits.cl."""
_VECTOR_LENGTHS = (1, 4, 8, 16)
_ARRAY_BYTES = 2**28
_REPETITIONS = 5


@dataclass(frozen=True)
class Limits:
    """The highest rates that the kernels in limits.cl reach on the device."""

    flops: float
    """Single-precision operations per second. A multiply-add counts as two."""
    read_bytes: float
    """Bytes per second when streaming through an array too large for any cache. Likewise `write_bytes`."""
    write_bytes: float

    @property
    def bandwidth(self) -> float:
        """Bytes per second in the faster direction."""
        return max(self.read_bytes, self.write_bytes)


def measure_limits() -> Limits:
    """Measure the device that `choose_device` selects. Takes a few seconds."""
    backend = Backend(choose_device(), profile=True)
    group_size = 1 if backend.device.is_cpu else 256
    each = [_measure_with(backend, lanes, group_size) for lanes in _VECTOR_LENGTHS]
    return Limits(*(max(values) for values in zip(*each, strict=True)))


def _measure_with(backend: Backend, lanes: int, group_size: int) -> tuple[float, float, float]:
    """(operations, bytes read, bytes written) per second, with vectors of `lanes` floats."""
    vector = "float" if lanes == 1 else f"float{lanes}"
    options = ["-w", f"-DVECTOR={vector}", f"-DLANES={lanes}"]
    program = pyopencl.Program(backend.context, _KERNELS.read_text(encoding="utf-8")).build(options, cache_dir=False)
    flags = pyopencl.mem_flags.READ_WRITE
    groups = backend.device.handle.max_compute_units * (4 if backend.device.is_cpu else 32)
    results = pyopencl.Buffer(backend.context, flags, 4 * groups * group_size)

    steps = 2**18 // lanes if backend.device.is_cpu else 2**14
    compute = _shortest(backend, program.multiply_add, groups, group_size, np.int32(steps), results)
    operations = 2 * groups * group_size * steps * _CHAINS * lanes

    vectors = _ARRAY_BYTES // (4 * lanes * groups)
    array = pyopencl.Buffer(backend.context, flags, 4 * lanes * groups * vectors)
    moved = 4 * lanes * groups * vectors
    write, read = (
        _shortest(backend, kernel, groups, group_size, np.int32(vectors), array, results)
        for kernel in (program.stream_write, program.stream_read)
    )
    return operations / compute, moved / read, moved / write


def _shortest(
    backend: Backend, kernel: pyopencl.Kernel, groups: int, group_size: int, *arguments: np.int32 | pyopencl.Buffer
) -> float:
    """Duration of the fastest of a few launches, in seconds."""
    durations = []
    for _ in range(_REPETITIONS):
        event = kernel(backend.queue, (groups * group_size,), (group_size,), *arguments)
        event.wait()
        durations.append(event.profile.end - event.profile.start)
    return min(durations) * 1e-9
