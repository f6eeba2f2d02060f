"""CUDA and OpenCL in a worker process, which runs one stage after another. Loads neither them nor torch.

Memory of a GPU that a stage leaves in a cache, torch's or our own, is unavailable to other processes, and the next
stage that needs it may well run in another worker. And after some errors, such as an illegal address in a kernel, every
CUDA call of the process fails until it ends: one failed stage would fail all later ones there.
"""

from __future__ import annotations

import sys
from types import ModuleType

_HOLDERS = ("opencl.staging",)
"""Modules besides torch that hold GPU memory, each with a function `return_held_memory`."""


def return_gpu_memory() -> None:
    """Returns unused GPU memory for other processes; to be called when a stage has ended."""
    if cuda_is_broken():
        return
    cuda = _cuda()
    if cuda is not None:
        cuda.empty_cache()
    for name in _HOLDERS:
        if name in sys.modules:
            sys.modules[name].return_held_memory()


def cuda_is_broken() -> bool:
    """Whether all further CUDA calls in this process will fail."""
    cuda = _cuda()
    try:
        if cuda is not None:
            cuda.synchronize()
    except RuntimeError:
        return True
    return False


def _cuda() -> ModuleType | None:
    """`torch.cuda` if a stage has used it, else None."""
    torch = sys.modules.get("torch")
    return torch.cuda if torch is not None and torch.cuda.is_initialized() else None
