"""Fused mean structural similarity of pictures, with its gradient: two passes over the rows instead of a hundred."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.first_gradients import first_gradients_only
from opencl.program import GROUP_SIZE, SSIM_COLUMNS, SSIM_ROWS, SSIM_STRIP, ProgramKey
from opencl.routes import backend_for

CHANNELS = 3
_PADDING, _LANES = 16, 16
"""As in ssim.cl: zeros on either side of a row, and values computed at a time."""


def mean_ssim(
    pictures: Float[Tensor, "*batch height width 3"], truths: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, ""]:
    """Structural similarity (Wang et al., 2004) as in 3DGS, averaged over all pixels and channels to a scalar.

    Uses an 11 x 11 Gaussian window of standard deviation 1.5, zeros beyond the borders, and the constants 0.01² and
    0.03² for a peak of 1. Both tensors must be float32, or both float64. The gradient reaches `pictures` only; it is
    computed together with the value if it is needed. The same inputs on the same device give the same bits, for any
    number of threads. (On the CPU, this holds for fewer than 32,768 row strips of 256 values, such as one picture of
    2000 x 1360: torch adds the sums of more strips in as many parts as it has threads.)

    Raises ValueError for wrong or different shapes, types or devices, for empty pictures, and if `truths` requires a
    gradient.
    """
    if pictures.shape != truths.shape or pictures.dtype != truths.dtype or pictures.device != truths.device:
        described = [f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}" for tensor in (pictures, truths)]
        raise ValueError(f"two pictures to compare must be alike in shape, type and device, not {described}")
    if pictures.ndim < 3 or pictures.shape[-1] != CHANNELS or pictures.numel() == 0:
        raise ValueError(f"pictures: found shape {tuple(pictures.shape)}, expected (..., height, width, 3), not empty")
    if pictures.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"pictures: found {pictures.dtype}, expected float32 or float64")
    if truths.requires_grad and torch.is_grad_enabled():
        raise ValueError("truths: found requires_grad, expected pictures without gradient (none is computed)")
    backend = backend_for(pictures.device)
    similarity: Tensor = _MeanSsim.apply(backend, *(tensor.to(backend.tensor_device) for tensor in (pictures, truths)))
    return similarity.to(pictures.device)


class _MeanSsim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, backend: Backend, pictures: Tensor, truths: Tensor) -> Tensor:
        height, width = pictures.shape[-3:-1]
        length = CHANNELS * width
        padded, padded_truths = (_padded(values, length) for values in (pictures, truths))
        memory = backend.memory
        slopes = [memory.zeros(*padded.shape, dtype=padded.dtype) for _ in range(3)]
        groups = _groups(backend, len(padded) // height, height, length, padded.dtype)
        group_size = GROUP_SIZE[backend.schedule]
        sums = memory.empty(groups, dtype=padded.dtype)
        program = ProgramKey("ssim", backend.schedule, pictures.dtype, RasterSettings())
        inputs = (len(padded), height, length, padded.shape[1], padded, padded_truths)
        with backend.session() as session:
            session.launch(program, "similarities", groups, *inputs, *slopes, sums, group_size=group_size)
            if ctx.needs_input_grad[1]:
                gradients = memory.empty(*padded.shape, dtype=padded.dtype)
                session.launch(
                    program, "similarity_gradient", groups, *inputs, *slopes, gradients, group_size=group_size
                )
                session.finish(gradients)
                ctx.save_for_backward(gradients.narrow(1, _PADDING, length))
            session.finish(sums)
        ctx.shape = pictures.shape
        return sums.sum() / pictures.numel()

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_mean: Tensor) -> tuple[None, Tensor, None]:
        (gradients,) = ctx.saved_tensors
        return None, (gradients * (grad_mean / ctx.shape.numel())).view(ctx.shape), None


def _groups(backend: Backend, pictures: int, height: int, length: int, dtype: torch.dtype) -> int:
    """Number of work-groups. Each belongs to one picture and writes one sum."""
    if backend.schedule == "cpu":
        return pictures * height * -(-length // SSIM_STRIP)
    return pictures * -(-height // SSIM_ROWS[dtype]) * -(-length // SSIM_COLUMNS)


def _padded(values: Tensor, length: int) -> Float[Tensor, "rows stride"]:
    """The rows of all pictures, each with zeros before and after it."""
    rows = values.detach().reshape(-1, length)
    return torch.nn.functional.pad(rows, (_PADDING, -length % _LANES + _PADDING))
