"""A pool of CPU memory for the rasterizer's own tensors, which is reused once they are gone.

The operating system clears new memory page by page at the first access. For a picture of 60 MB, that takes longer than
rendering it. torch returns large blocks at once and so pays this price on every call.
"""

from __future__ import annotations

import math
import threading
import weakref

import numpy as np
import torch
from torch import Tensor

from opencl.free_memory import free_memory

_NUMPY = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32, torch.int64: np.int64}
WAY_OUT = "Take a smaller picture, fewer features or, where they are drawn, fewer Gaussians."

_SMALLEST = 2**18
"""Size in bytes below which torch's own allocation is as fast."""
_KEPT = 2**29
"""Maximum number of unused bytes that the pool keeps."""
_LARGE = 2**29
"""Size in bytes from which free memory is checked first. The operating system grants memory that it does not have, and
kills the process at the first access."""
_ALIGNMENT = 64
"""Bytes of a cache line. An access to an aligned vector touches only one."""


class _Pool:
    """Unused blocks of memory, oldest first.

    `release` runs whenever a tensor dies, even if the garbage collector interrupts a method of this class. Loops
    therefore run over copies of the list.
    """

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._lock = threading.RLock()

    def take(self, size: int) -> np.ndarray:
        """A block of at least `size` bytes, and at most a quarter more. Allocates one if the pool has none."""
        with self._lock:
            for block in tuple(self._blocks):
                if size <= block.nbytes <= size + size // 4:
                    self._remove(block)
                    return block
        _check_room(size)
        try:
            unaligned = np.empty(size + _ALIGNMENT, np.uint8)
        except MemoryError as error:  # a limit that free_memory does not see, such as ulimit's
            raise RuntimeError(f"no room for {size / 2**30:.2f} GiB: {error}. {WAY_OUT}") from error
        return unaligned[-unaligned.ctypes.data % _ALIGNMENT :][:size]

    def release(self, block: np.ndarray) -> None:
        with self._lock:
            self._blocks.append(block)
            while sum([kept.nbytes for kept in tuple(self._blocks)]) > _KEPT:
                del self._blocks[0]

    def _remove(self, wanted: np.ndarray) -> None:
        self._blocks = [block for block in tuple(self._blocks) if block is not wanted]


def _check_room(size: int) -> None:
    free = free_memory() if size >= _LARGE else None
    if free is not None and size > free:
        raise RuntimeError(f"no room for {size / 2**30:.2f} GiB: {free / 2**30:.2f} are free. {WAY_OUT}")


_pool = _Pool()


def empty(*shape: int, dtype: torch.dtype) -> Tensor:
    """An uninitialised, contiguous CPU tensor whose memory returns to the pool when no tensor uses it any more.

    Raises RuntimeError with a remedy if there is no room for a large tensor.
    """
    size = math.prod(shape) * dtype.itemsize
    if size < _SMALLEST:
        return torch.empty(shape, dtype=dtype, device="cpu")
    block = _pool.take(size)
    array = block[:size].view(_NUMPY[dtype]).reshape(shape)
    weakref.finalize(array, _pool.release, block).atexit = False  # torch holds the array as long as its storage lives
    return torch.from_numpy(array)
