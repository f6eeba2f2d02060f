"""Memory of the rasterizer's tensors, and how kernels access it. Each backend has one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import pyopencl
import torch
from torch import Tensor

from opencl.pool import WAY_OUT, empty

_SMALL = 4096
"""Size in bytes up to which an extra copy is faster than waiting for the device: cameras, backgrounds."""


@contextmanager
def room_on(context: pyopencl.Context, size: int) -> Iterator[None]:
    """If the block fails to allocate `size` bytes on the context's device, raise a RuntimeError with a remedy."""
    try:
        yield
    except pyopencl.Error as error:
        (device,), gib = context.devices, 2**30
        raise RuntimeError(
            f"device {device.name.strip()}: no room for {size / gib:.2f} GiB in one piece ({error}), it takes at most "
            f"{device.max_mem_alloc_size / gib:.2f}. {WAY_OUT}"
        ) from error


def moved(tensor: Tensor, device: torch.device) -> Tensor:
    """Copy a tensor to a torch device, like `Tensor.to`, but do not wait for a CUDA device if the tensor is small.

    A non-blocking copy may read CPU memory, pinned or not, after its owner has changed or freed it. Small tensors
    without gradient therefore go through pinned memory of torch's own, which torch does not reuse before the copy is
    done. For all others, the host waits for the copy.
    """
    goes_up = device.type == "cuda" and tensor.is_cpu
    if goes_up and tensor.nbytes <= _SMALL and not tensor.is_pinned() and not tensor.requires_grad:
        return tensor.pin_memory().to(device, non_blocking=True)
    return tensor.to(device)


class Memory(Protocol):
    """Memory of the tensors that kernels work on.

    Tensors from `empty` and `zeros` are the rasterizer's own and stay on the kernels' device. The caller's inputs enter
    by `receive`; results for the caller leave by the session's `give`. Any other tensor on `tensor_device` may be used
    within a single session. If the device runs out of memory, a RuntimeError suggests a remedy.
    """

    @property
    def tensor_device(self) -> torch.device:
        """The torch device of all tensors that are passed to kernels."""

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        """An uninitialised tensor of the rasterizer's own, for a kernel to write."""

    def zeros(self, *size: int, dtype: torch.dtype) -> Tensor:
        """A tensor of the rasterizer's own, filled with zeros."""

    def receive(self, tensor: Tensor) -> Tensor:
        """The caller's tensor as kernels read it: contiguous, and valid in any session. Differentiable."""

    def refuse_copies(self, *kept: Tensor) -> None:
        """Check tensors saved for backward. Raises RuntimeError if one came back as a copy without the contents."""


class BufferMemory(Memory, Protocol):
    """Memory that OpenCL kernels access as buffers. Tensors must be contiguous and not empty."""

    def resident(self, tensor: Tensor) -> pyopencl.Buffer | None:
        """The buffer of a tensor that is resident on the device, or None for any other tensor."""

    def place(self, tensor: Tensor) -> pyopencl.Buffer:
        """A new buffer with the contents of the tensor, for one session."""

    def fetch(self, tensor: Tensor, buffer: pyopencl.Buffer) -> None:
        """Copy the buffer to the tensor. The contents are valid once the queue is finished."""

    def give(self, tensor: Tensor, buffer: pyopencl.Buffer) -> Tensor:
        """A tensor for the caller with the contents of the buffer. They are valid once the queue is finished."""


def as_kernels_read(tensor: Tensor) -> Tensor:
    """The tensor, contiguous and with torch's lazy negation resolved."""
    return tensor.contiguous().resolve_neg()


class TorchMemory:
    """Torch's own memory on a torch device."""

    def __init__(self, tensor_device: torch.device) -> None:
        self._tensor_device = tensor_device

    @property
    def tensor_device(self) -> torch.device:
        return self._tensor_device

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        try:
            return torch.empty(size, dtype=dtype, device=self._tensor_device)
        except torch.OutOfMemoryError as error:
            raise torch.OutOfMemoryError(f"{self._tensor_device}: {error} {WAY_OUT}") from error

    def zeros(self, *size: int, dtype: torch.dtype) -> Tensor:
        return self.empty(*size, dtype=dtype).zero_()

    def receive(self, tensor: Tensor) -> Tensor:
        return as_kernels_read(moved(tensor, self._tensor_device))

    def refuse_copies(self, *kept: Tensor) -> None:
        """Do nothing: here, copies have the contents."""


class SharedMemory(TorchMemory):
    """Torch's CPU memory, in which the device's kernels work in place."""

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
        """Do nothing: the buffer is the tensor's memory."""

    def give(self, tensor: Tensor, buffer: pyopencl.Buffer) -> Tensor:
        return tensor
