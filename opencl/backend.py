"""Builds OpenCL programs and launches their kernels on torch tensors."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar

import numpy as np
import pyopencl
import torch
from torch import Tensor

from opencl.device import DEVICE_VARIABLE, Device, choose_device
from opencl.memory import BufferMemory, Memory, SharedMemory
from opencl.once import once
from opencl.pool import WAY_OUT
from opencl.program import ProgramKey, Schedule
from opencl.staging import StagedMemory

BUILD_OPTIONS: dict[Schedule, tuple[str, ...]] = {"cpu": ("-w",), "gpu": ("-w",)}
"""Options of the OpenCL compiler, by schedule."""


class Session:
    """Launches kernels in order on one queue. Tensors must be contiguous and on the backend's tensor device."""

    memory: Memory
    """The memory of the backend."""
    torch_is_in_order: ClassVar[bool] = False
    """Whether torch operations on the tensors run in order with the launches, without `finish` in between."""

    def __init__(self, backend: Backend, memory: BufferMemory) -> None:
        self._backend, self._memory = backend, memory
        self.memory = memory
        self._buffers: dict[tuple[int, int], tuple[Tensor, pyopencl.Buffer]] = {}

    def launch(
        self, program: ProgramKey, kernel: str, groups: int, *arguments: Tensor | int, group_size: int = 1
    ) -> None:
        """Queue `groups` work-groups of a kernel. Passes integers as int32, tensors as buffers, empty ones as null."""
        if groups == 0:
            return
        prepared = [np.int32(value) if isinstance(value, int) else self._buffer(value) for value in arguments]
        sizes = ((groups * group_size,), (group_size,))
        event = self._backend.kernel(program, kernel)(self._backend.queue, *sizes, *prepared)
        if self._backend.profiled is not None:
            self._backend.profiled.append((kernel, event))

    def _buffer(self, tensor: Tensor) -> pyopencl.Buffer | None:
        if tensor.numel() == 0:
            return None
        resident = self._memory.resident(tensor)
        if resident is not None:
            return resident
        place = (tensor.data_ptr(), tensor.nbytes)
        if place not in self._buffers:
            self._buffers[place] = (tensor, self._memory.place(tensor))
        return self._buffers[place][1]

    def finish(self, *results: Tensor) -> None:
        """Wait for all launches, so that torch can read `results`. These remain the rasterizer's own tensors."""
        for tensor in results:
            buffer = self._buffer(tensor)
            if buffer is not None:
                self._memory.fetch(tensor, buffer)
        self._backend.queue.finish()

    def give(self, *results: Tensor) -> tuple[Tensor, ...]:
        """Wait for all launches. Returns `results` as tensors that the caller may keep and modify."""
        given = []
        for tensor in results:
            buffer = self._buffer(tensor)
            given.append(tensor if buffer is None else self._memory.give(tensor, buffer))
        self._backend.queue.finish()
        return tuple(given)


class Backend:
    """A device with its queue and its compiled programs. Thread-safe: sessions of different threads take turns."""

    def __init__(
        self,
        device: Device,
        schedule: Schedule | None = None,
        shares_memory: bool | None = None,
        profile: bool = False,
    ) -> None:
        """`schedule` and `shares_memory` default to what suits the device.

        `shares_memory=False` keeps the contents of tensors on the device, as a device with its own memory needs.
        With `profile`, `profiled` collects the kernel's name and the event of every launch.
        """
        device.prepare()
        self.device = device
        self.schedule: Schedule = schedule or ("cpu" if device.is_cpu else "gpu")
        self.profiled: list[tuple[str, pyopencl.Event]] | None = [] if profile else None
        self.shares_memory = device.shares_memory if shares_memory is None else shares_memory
        self.context = pyopencl.Context([device.handle])
        properties = pyopencl.command_queue_properties.PROFILING_ENABLE if profile else 0
        self.queue = pyopencl.CommandQueue(self.context, properties=properties)
        self._buffers: BufferMemory = (
            SharedMemory(self.context) if self.shares_memory else StagedMemory(self.context, self.queue)
        )
        self.memory: Memory = self._buffers
        self._programs: dict[ProgramKey, pyopencl.Program] = {}
        self._kernels: dict[tuple[ProgramKey, str], pyopencl.Kernel] = {}
        self._lock = threading.RLock()
        self._process = os.getpid()

    @property
    def tensor_device(self) -> torch.device:
        """The torch device of the tensors that kernels take."""
        return self.memory.tensor_device

    @contextmanager
    def session(self) -> Iterator[Session]:
        """Lock the backend for this thread, since setting a kernel's arguments is not thread-safe.

        Raises RuntimeError in a process that was forked after the backend was created, and if the device finds only
        when kernels are launched, or when they run, that it lacks memory or other resources.
        """
        if os.getpid() != self._process:
            raise RuntimeError("OpenCL was set up before this process was forked and would hang: start it by spawn")
        try:
            with self._lock, self._launching() as session:
                yield session
        except pyopencl.MemoryError as error:  # not a RuntimeError of Python
            raise RuntimeError(f"device {self.device.name}: {error}. {WAY_OUT}") from error

    @contextmanager
    def _launching(self) -> Iterator[Session]:
        try:
            yield Session(self, self._buffers)
        finally:
            if self.shares_memory:  # torch may free the tensors once the session ends
                self.queue.finish()

    def build(self, program: ProgramKey) -> pyopencl.Program:
        """Compile a program. Raises ValueError for float64 if the device has no double precision."""
        if program.dtype == torch.float64 and not self.device.handle.double_fp_config:
            raise ValueError(f"found float64, expected float32: {self.device.name} has no double precision")
        # PoCL caches compiled kernels itself, so pyopencl's cache of binaries would be redundant.
        options = [*BUILD_OPTIONS[program.schedule]]
        return pyopencl.Program(self.context, program.text()).build(options=options, cache_dir=False)

    def kernel(self, program: ProgramKey, name: str) -> pyopencl.Kernel:
        """The kernel `name` of a program, which is built on first use."""
        kernel = self._kernels.get((program, name))
        if kernel is None:
            if program not in self._programs:
                self._programs[program] = self.build(program)
            kernel = self._kernels[program, name] = pyopencl.Kernel(self._programs[program], name)
        return kernel


@once
def _backend_for(setting: str) -> Backend:
    """The default backend while GS_HIDER_DEVICE is `setting`, the key of the cache."""
    return Backend(choose_device())


def default_backend() -> Backend:
    """This process's backend for the device that GS_HIDER_DEVICE currently names, or for the default device."""
    return _backend_for(os.environ.get(DEVICE_VARIABLE, ""))
