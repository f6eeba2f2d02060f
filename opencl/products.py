"""Common parts of the CPU kernels that multiply matrices (kernels/cpu/products.cl)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import Part, ProgramKey

LANES = 16
"""Channels processed at a time, as one vector."""
_PARTS = 8
"""Maximum number of work-items that share a sum: the same on every processor, for the same bits."""
_FOR_A_CORE = 2
"""Work-items per core of other launches, for load balance. Not more, as each has scratch memory of its own."""


def filled(channels: int) -> int:
    """`channels` rounded up to a multiple of LANES."""
    return -(-channels // LANES) * LANES


def summing_items(chunks: int) -> int:
    """Number of work-items for so many chunks if their sums depend on how chunks are assigned to work-items."""
    return min(_PARTS, chunks)


def work_items(backend: Backend, chunks: int) -> int:
    """Number of work-items for so many chunks if the result of a chunk is the same in any work-item."""
    return min(chunks, max(_PARTS, _FOR_A_CORE * backend.device.handle.max_compute_units))


def added(parts: Float[Tensor, "items sums"]) -> Float[Tensor, " sums"]:
    """The sum of all parts, added one after the other. The order in which `parts.sum(dim=0)` adds is up to torch.

    The result is a new tensor, of zeros if there are no parts.
    """
    total = parts[:1].sum(dim=0)
    for part in parts[1:]:
        total += part
    return total


def product_program(backend: Backend, part: Part, dtype: torch.dtype) -> ProgramKey:
    """The program of such kernels for `part`, compiled for the width of the processor's registers."""
    is_wide = backend.device.handle.native_vector_width_float >= LANES
    return ProgramKey(part, "cpu", dtype, RasterSettings(), options=("WIDE_REGISTERS",) if is_wide else ())
