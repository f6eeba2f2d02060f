"""Where the rasterizer's tensors live, and how kernels reach them: each backend has one of these."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import pyopencl
import torch
from torch import Tensor

from opencl.pool import WAY_OUT, empty

_SMALL = 4096
"""Bytes that are copied once more in less time than a device is waited for: a camera, a background."""


@contextmanager
def room_on(context: pyopencl.Context, size: int) -> Iterator[None]:
    """Around what allocates `size` bytes on the context's device: `RuntimeError` with a way out where that fails."""
    try:
        yield
    except pyopencl.Error as error:
        (device,), gib = context.devices, 2**30
        raise RuntimeError(
            f"device {device.name.strip()}: no room for {size / gib:.2f} GiB in one piece ({error}), it takes at most "
            f"{device.max_mem_alloc_size / gib:.2f}. {WAY_OUT}"
        ) from error


def moved(tensor: Tensor, device: torch.device) -> Tensor:
    """The tensor on a device of torch's, as `Tensor.to` has it, but a CUDA device is not waited for with a small one.

    It may read the CPU's memory later, pinned or not, when its owner has changed or freed it. So what is small goes by
    pinned memory of torch's own, which torch uses for nothing else until it is read; for the rest the device is waited
    for.
    """
    goes_up = device.type == "cuda" and tensor.is_cpu
    if goes_up and tensor.nbytes <= _SMALL and not tensor.is_pinned() and not tensor.requires_grad:
        return tensor.pin_memory().to(device, non_blocking=True)
    return tensor.to(device)


class Memory(Protocol):
    """Tensors that kernels work on.

    Those made by `empty` and `zeros` are the rasterizer's own and stay where the kernels are; what the caller gave
    comes in by `receive`, and what the caller gets goes out by the session's `give`. Other tensors on `tensor_device`
    may be used within one session. Where the device has no room for one, a `RuntimeError` says so with a way out.
    """

    @property
    def tensor_device(self) -> torch.device:
        """Where all tensors given to kernels are to be."""

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        """A tensor of the rasterizer's own, undefined until a kernel writes it."""

    def zeros(self, *size: int, dtype: torch.dtype) -> Tensor:
        """A tensor of the rasterizer's own, of zeros."""

    def receive(self, tensor: Tensor) -> Tensor:
        """The caller's tensor as kernels read it, contiguous, for as long as it is kept. Differentiable."""

    def refuse_copies(self, *kept: Tensor) -> None:
        """Of what was kept for the backward pass; `RuntimeError` where some came back as copies that hold nothing."""


class BufferMemory(Memory, Protocol):
    """Memory that an OpenCL kernel sees as buffers. Tensors are contiguous and not empty."""

    def resident(self, tensor: Tensor) -> pyopencl.Buffer | None:
        """The buffer of one of the rasterizer's own tensors; None for others."""

    def place(self, tensor: Tensor) -> pyopencl.Buffer:
        """A new buffer with what the tensor holds, for one session."""

    def fetch(self, tensor: Tensor, buffer: pyopencl.Buffer) -> None:
        """Make the tensor hold what the buffer does, once the queue is finished."""

    def give(self, tensor: Tensor, buffer: pyopencl.Buffer) -> Tensor:
        """The caller's tensor with what the buffer holds, once the queue is finished."""


def as_kernels_read(tensor: Tensor) -> Tensor:
    """Contiguous, and every number as it is written: torch may negate lazily."""
    return tensor.contiguous().resolve_neg()


class TorchMemory:
    """Torch's own memory on a device of torch's."""

    def __init__(self, tensor_device: torch.device) -> None:
        self._tensor_device = tensor_device

    @property
    def tensor_device(self) -> torch.device:
        return self._tensor_device

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        try:
            return torch.empty(size, dtype=dtype, device=self._tensor_device)
        except torch.OutOfMemoryError as error:
            raise RuntimeError(f"{self._tensor_device}: {error} {WAY_OUT}") from error

    def zeros(self, *size: int, dtype: torch.dtype) -> Tensor:
        return self.empty(*size, dtype=dtype).zero_()

    def receive(self, tensor: Tensor) -> Tensor:
        return as_kernels_read(moved(tensor, self._tensor_device))

    def refuse_copies(self, *kept: Tensor) -> None:
        """A copy holds what it is one of."""


class SharedMemory(TorchMemory):
    """Torch's memory on the CPU, on which the device's kernels work in place."""

    def __init__(self, context: pyopencl.Context) -> None:
        super().__init__(torch.device("cpu"))
        self._context = context

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        return empty(*size, dtype=dtype)

    def resident(self, tensor: Tensor) -> pyopencl.Buffer | None:
        return None

    def place(self, tensor: Tensor) -> pyopencl.Buffer:
        flags = pyopencl.mem_flags.READ_WRITE | pyopencl.mem_flags.USE_HOST_PTR
        with room_on(self._context, tensor.nbytes):
            return pyopencl.Buffer(self._context, flags, hostbuf=tensor.detach().numpy())

    def fetch(self, tensor: Tensor, buffer: pyopencl.Buffer) -> None:
        """The tensor is the buffer."""

    def give(self, tensor: Tensor, buffer: pyopencl.Buffer) -> Tensor:
        return tensor
