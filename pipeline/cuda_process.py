"""CUDA and OpenCL in a worker process, which goes on from stage to stage; neither they nor torch are loaded for it.

What a stage leaves in a cache of a GPU's memory, torch's or our own, is no other process's, and the next stage that
draws may well be another worker's. And after some errors, such as a kernel's illegal address, every call of CUDA fails
in a process until it ends: one stage's failure would be that of all that come after it there.
"""

from __future__ import annotations

import sys
from types import ModuleType

_HOLDERS = ("opencl.staging",)
"""Modules that keep memory of GPUs beside torch, each with a function `return_held_memory`."""


def return_gpu_memory() -> None:
    """Gives back what is free of the GPUs' memory, for other processes: when a stage has ended."""
    if cuda_is_broken():
        return
    cuda = _cuda()
    if cuda is not None:
        cuda.empty_cache()
    for name in _HOLDERS:
        if name in sys.modules:
            sys.modules[name].return_held_memory()


def cuda_is_broken() -> bool:
    """Whether calls of CUDA can only fail in this process from now on."""
    cuda = _cuda()
    try:
        if cuda is not None:
            cuda.synchronize()
    except RuntimeError:
        return True
    return False


def _cuda() -> ModuleType | None:
    """torch.cuda, where a stage has used it."""
    torch = sys.modules.get("torch")
    return torch.cuda if torch is not None and torch.cuda.is_initialized() else None
