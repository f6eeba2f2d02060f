"""What the CPU's kernels that multiply matrices have in common (kernels/cpu/products.cl)."""

from __future__ import annotations

import torch

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import Part, ProgramKey

LANES = 16
"""Channels that are taken at a time."""
GROUPS = 8
"""Work-items at most, each with a part of the weights' gradients: as many on any processor, for the same bits."""


def filled(channels: int) -> int:
    """Channels up to a multiple of LANES."""
    return -(-channels // LANES) * LANES


def product_program(backend: Backend, part: Part, dtype: torch.dtype) -> ProgramKey:
    """A program of such kernels, for as many registers as the processor has."""
    is_wide = backend.device.handle.native_vector_width_float >= LANES
    return ProgramKey(part, "cpu", dtype, RasterSettings(), options=("WIDE_REGISTERS",) if is_wide else ())
