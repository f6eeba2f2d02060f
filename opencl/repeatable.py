"""torch's own arithmetic on CUDA devices: float32 as on a CPU, and the same bits each time."""

from __future__ import annotations

import os

import torch


def ask_for_the_same_bits() -> None:
    """For this process, from here on; on the CPU nothing changes.

    By itself torch rounds what float32 convolutions multiply to TF32 (10 bits of mantissa), and what matrices multiply
    where TORCH_ALLOW_TF32_CUBLAS_OVERRIDE is set, as in some containers; and it takes whichever algorithm is fastest,
    some of which add in no fixed order. Of an operation that torch cannot repeat it warns, and goes on.
    """
    torch.backends.cudnn.allow_tf32 = False
    torch.set_float32_matmul_precision("highest")
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # looked at when matrices are first multiplied there
    torch.use_deterministic_algorithms(True, warn_only=True)
    # Or else torch writes all new memory once, to find who reads it.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]  # torch adds it unseen
