"""Makes torch's own operations on CUDA devices compute in full float32 and give the same bits each time."""

from __future__ import annotations

import os

import torch


def ask_for_the_same_bits() -> None:
    """Configure torch for the rest of this process. Nothing changes on the CPU.

    By default, torch rounds the factors of float32 convolutions to TF32 (10 bits of mantissa), and those of matrix
    products if TORCH_ALLOW_TF32_CUBLAS_OVERRIDE is set, as in some containers. It also selects the fastest algorithms,
    some of which add in no fixed order. For operations without a deterministic algorithm, torch warns and continues.
    """
    torch.backends.cudnn.allow_tf32 = False
    torch.set_float32_matmul_precision("highest")
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # read at the first matrix product on CUDA
    torch.use_deterministic_algorithms(True, warn_only=True)
    # Otherwise torch fills all new memory, so that reading it uninitialised is deterministic, too.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]  # added at run time
