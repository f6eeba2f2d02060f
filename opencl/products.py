"""What the CPU's kernels that multiply matrices have in common (kernels/cpu/products.cl)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import Part, ProgramKey

LANES = 16
"""Channels that are taken at a time."""
_PARTS = 8
"""Work-items at most that each have a part of a sum: as many on any processor, for the same bits."""
_FOR_A_CORE = 2
"""Work-items of other launches for each core, as cores do not all come to their end at once. Each has its scratch."""


def filled(channels: int) -> int:
    """Channels up to a multiple of LANES."""
    return -(-channels // LANES) * LANES


def summing_items(chunks: int) -> int:
    """Work-items that take so many chunks, where what they add up depends on which of them took which."""
    return min(_PARTS, chunks)


def work_items(backend: Backend, chunks: int) -> int:
    """Work-items that take so many chunks, where each chunk comes out the same whoever took it."""
    return min(chunks, max(_PARTS, _FOR_A_CORE * backend.device.handle.max_compute_units))


def added(parts: Float[Tensor, "items sums"]) -> Float[Tensor, " sums"]:
    """The sum of all parts, one after the other: in which order `parts.sum(dim=0)` adds is torch's own affair.

    In memory of its own; zeros where there are no parts.
    """
    total = parts[:1].sum(dim=0)
    for part in parts[1:]:
        total += part
    return total


def product_program(backend: Backend, part: Part, dtype: torch.dtype) -> ProgramKey:
    """A program of such kernels, for as many registers as the processor has."""
    is_wide = backend.device.handle.native_vector_width_float >= LANES
    return ProgramKey(part, "cpu", dtype, RasterSettings(), options=("WIDE_REGISTERS",) if is_wide else ())
