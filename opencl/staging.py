"""CPU tensors for a device with its own memory: copied through pinned memory, and only if necessary.

The rasterizer's own tensors stay on the device. On the CPU, they are only handles of device buffers, and their pages
are never touched. Inputs are copied once, on entry, so that later changes by the caller, of whatever kind, have no
effect. Outputs for the caller are ordinary tensors without a buffer. A buffer is looked up by the storage of its
tensor, to which a weak reference is held: as long as that exists, no other storage can have the same identity.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass

import numpy as np
import pyopencl
import pyopencl.tools
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.multiprocessing.reductions import StorageWeakRef

from opencl.memory import room_on

_PINNED_BYTES = 1 << 23
"""Size of each of two pinned areas. While one is being transferred, the host fills or reads the other."""


@dataclass
class _Resident:
    """A tensor that has, or will get, a buffer on the device."""

    storage: StorageWeakRef
    version: int
    """Version of the tensor when it last agreed with the buffer. Autograd may add gradients in place."""
    on_host: bool
    """Whether the CPU tensor itself holds the contents."""
    buffer: pyopencl.Buffer | None
    """None if nothing has been copied to the device yet."""


class StagedMemory:
    """The memory of a device behind a bus. As its queue works in order, buffers are reused without waiting."""

    def __init__(self, context: pyopencl.Context, queue: pyopencl.CommandQueue) -> None:
        self._pinned = _PinnedCopies(context, queue)
        self._context, self._queue = context, queue
        self._allocator = pyopencl.tools.ImmediateAllocator(queue, pyopencl.mem_flags.READ_WRITE)
        self._pool = pyopencl.tools.MemoryPool(self._allocator)
        self._most_in_use, self._largest = 0, context.devices[0].max_mem_alloc_size
        self._residents: dict[int, _Resident] = {}
        self._lock = threading.RLock()
        _memories.add(self)

    @property
    def tensor_device(self) -> torch.device:
        return torch.device("cpu")

    @property
    def uploaded(self) -> int:
        """Bytes copied to the device so far."""
        return self._pinned.uploaded

    @property
    def downloaded(self) -> int:
        """Bytes copied from the device so far."""
        return self._pinned.downloaded

    def empty(self, *size: int, dtype: torch.dtype) -> Tensor:
        tensor = torch.empty(size, dtype=dtype, device="cpu")
        if tensor.numel():
            self._keep(tensor, on_host=False, buffer=self._allocate(tensor.nbytes))
        return tensor

    def zeros(self, *size: int, dtype: torch.dtype) -> Tensor:
        tensor = torch.zeros(size, dtype=dtype, device="cpu")
        if tensor.numel():
            buffer = self._allocate(tensor.nbytes)
            pyopencl.enqueue_fill_buffer(self._queue, buffer, np.uint8(0), 0, tensor.nbytes)
            self._keep(tensor, on_host=True, buffer=buffer)
        return tensor

    def receive(self, tensor: Tensor) -> Tensor:
        own = tensor.to("cpu", copy=True, memory_format=torch.contiguous_format)
        if own.numel():
            self._keep(own, on_host=True, buffer=None)
        return own

    def refuse_copies(self, *kept: Tensor) -> None:
        for tensor in kept:
            if tensor.numel() and tensor.untyped_storage()._cdata not in self._residents:
                raise RuntimeError(
                    f"tensor of shape {tuple(tensor.shape)}: found a copy of what was kept for the backward pass, as "
                    "hooks on saved tensors make (torch.autograd.graph.saved_tensors_hooks, save_on_cpu), expected the "
                    "tensor itself: only the device holds what is in it. Draw outside of such hooks"
                )

    def _keep(self, tensor: Tensor, on_host: bool, buffer: pyopencl.Buffer | None) -> None:
        storage = tensor.untyped_storage()
        with self._lock:
            self._residents[storage._cdata] = _Resident(StorageWeakRef(storage), _version(tensor), on_host, buffer)

    def _forget_gone(self) -> None:
        gone = [key for key, kept in self._residents.items() if kept.storage.expired()]
        for key in gone:
            del self._residents[key]

    def return_held(self) -> None:
        """Free the device memory that no tensor uses."""
        with self._lock:
            self._forget_gone()
            self._pool.free_held()

    def resident(self, tensor: Tensor) -> pyopencl.Buffer | None:
        storage = tensor.untyped_storage()
        with self._lock:
            kept = self._residents.get(storage._cdata)
        if kept is None:
            return None
        is_part = tensor.nbytes != storage.nbytes()
        is_changed = kept.version != _version(tensor)
        if not kept.on_host and (is_part or is_changed):
            found = "a part" if is_part else "a change on the CPU"
            raise RuntimeError(
                f"tensor of shape {tuple(tensor.shape)}: found {found} of what only the device holds, expected it "
                "whole and untouched: fetch it first, by the session's finish"
            )
        if is_part:
            return None
        if kept.buffer is None or is_changed:
            kept.buffer, kept.version = self.place(tensor), _version(tensor)
        return kept.buffer

    def place(self, tensor: Tensor) -> pyopencl.Buffer:
        buffer = self._allocate(tensor.nbytes)
        self._pinned.upload(_bytes_of(tensor), buffer)
        return buffer

    def _allocate(self, size: int) -> pyopencl.Buffer:
        """Allocate a buffer, reusing one from the pool if possible.

        The pool keeps buffers for requests of about the same size. As sizes grow during a training, it would fill the
        device. It is therefore emptied when its total would exceed twice the most bytes ever in use at once. The pool
        is bypassed if it would round the size up beyond the device's largest possible allocation. Buffers of tensors
        that are gone return to it first, or the largest would be held twice.
        """
        with room_on(self._context, size), self._lock:
            self._forget_gone()
            if size <= self._largest < self._pool.alloc_size(self._pool.bin_number(size)):
                self._pool.free_held()
                return self._allocator(size)
            self._most_in_use = max(self._most_in_use, self._pool.active_bytes + size)
            if self._pool.managed_bytes + size > 2 * self._most_in_use:
                self._pool.free_held()
            return self._pool.allocate(size)

    def fetch(self, tensor: Tensor, buffer: pyopencl.Buffer) -> None:
        self._pinned.download(buffer, _bytes_of(tensor))
        with self._lock:
            kept = self._residents.get(tensor.untyped_storage()._cdata)
            if kept is not None:
                kept.on_host = True

    def give(self, tensor: Tensor, buffer: pyopencl.Buffer) -> Tensor:
        given = torch.empty_like(tensor)
        self._pinned.download(buffer, _bytes_of(given))
        return given


_memories: weakref.WeakSet[StagedMemory] = weakref.WeakSet()
"""All instances in this process."""


def return_held_memory() -> None:
    """Free all device memory that no tensor of this process uses, for other processes. Call it after a stage."""
    for memory in tuple(_memories):
        memory.return_held()


class _PinnedCopies:
    """Copies between CPU and device memory through pinned memory, which the device accesses directly."""

    def __init__(self, context: pyopencl.Context, queue: pyopencl.CommandQueue) -> None:
        self._context, self._queue = context, queue
        self._areas: list[NDArray[np.uint8]] = []
        self._events: list[pyopencl.Event | None] = [None, None]
        self.uploaded = self.downloaded = 0

    def upload(self, source: NDArray[np.uint8], buffer: pyopencl.Buffer) -> None:
        """Copy `source` to the buffer. The caller may change it as soon as this returns."""
        for turn, start in enumerate(range(0, len(source), _PINNED_BYTES)):
            part = source[start : start + _PINNED_BYTES]
            area = self._free_area(turn)[: len(part)]
            np.copyto(area, part)
            self._events[turn % 2] = pyopencl.enqueue_copy(
                self._queue, buffer, area, dst_offset=start, is_blocking=False
            )
        self.uploaded += len(source)

    def download(self, buffer: pyopencl.Buffer, target: NDArray[np.uint8]) -> None:
        """Copy the buffer to `target`, which is complete when this returns."""
        starts = range(0, len(target), _PINNED_BYTES)
        parts = [target[start : start + _PINNED_BYTES] for start in starts]
        for turn, start in enumerate(starts):
            area = self._free_area(turn)[: len(parts[turn])]
            self._events[turn % 2] = pyopencl.enqueue_copy(
                self._queue, area, buffer, src_offset=start, is_blocking=False
            )
            if turn:
                np.copyto(parts[turn - 1], self._free_area(turn - 1)[: len(parts[turn - 1])])
        np.copyto(parts[-1], self._free_area(len(parts) - 1)[: len(parts[-1])])
        self.downloaded += len(target)

    def _free_area(self, turn: int) -> NDArray[np.uint8]:
        """One of the two areas in turn, after its previous copy has finished. Both stay mapped."""
        if not self._areas:
            with room_on(self._context, _PINNED_BYTES):
                self._areas = [self._mapped_area(), self._mapped_area()]
        event, self._events[turn % 2] = self._events[turn % 2], None
        if event is not None:
            event.wait()
        return self._areas[turn % 2]

    def _mapped_area(self) -> NDArray[np.uint8]:
        flags, access = pyopencl.mem_flags, pyopencl.map_flags
        pinned = pyopencl.Buffer(self._context, flags.READ_WRITE | flags.ALLOC_HOST_PTR, _PINNED_BYTES)
        area, _mapped = pyopencl.enqueue_map_buffer(
            self._queue, pinned, access.READ | access.WRITE, 0, (_PINNED_BYTES,), np.dtype(np.uint8)
        )
        return area


def _bytes_of(tensor: Tensor) -> NDArray[np.uint8]:
    """The memory of a contiguous tensor."""
    return tensor.detach().view(-1).view(torch.uint8).numpy()


def _version(tensor: Tensor) -> int:
    """torch's count of in-place changes. 0 in inference mode, which neither counts them nor adds gradients."""
    return 0 if tensor.is_inference() else tensor._version
