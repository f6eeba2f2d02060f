"""Convolutions whose factors NVIDIA GPUs round to TF32 (10-bit mantissa), which is torch's default."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor


def convolve_rounded(
    values: Float[Tensor, "B C H W"], weight: Float[Tensor, "D C side side"], bias: Float[Tensor, " D"]
) -> Float[Tensor, "B D H W"]:
    """`torch.nn.functional.conv2d` that keeps the picture's size, for kernels with an odd side.

    On a CUDA device, factors are rounded to TF32, forward and backward, and sums are not; on the CPU, everything is
    float32. The process's settings for other convolutions (`opencl.repeatable`) stay as they are.
    """
    convolved: Tensor = _RoundedConvolution.apply(values, weight, bias)
    return convolved


class _RoundedConvolution(torch.autograd.Function):
    """Needed since torch's own convolution would consult the process's setting again in the backward pass."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(values, weight)
        with _rounding():
            return torch.nn.functional.conv2d(values, weight, bias, padding=weight.shape[-1] // 2)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        values, weight = ctx.saved_tensors
        border = 2 * [weight.shape[-1] // 2]
        shape = ([len(weight)], [1, 1], border, [1, 1], False, [0, 0], 1)
        with _rounding():
            gradients: tuple[Tensor | None, ...] = torch.ops.aten.convolution_backward(
                gradient, values, weight, *shape, [*ctx.needs_input_grad]
            )
        return gradients


@contextmanager
def _rounding() -> Iterator[None]:
    library = torch.backends.cudnn
    with library.flags(
        enabled=library.enabled, benchmark=library.benchmark, deterministic=library.deterministic, allow_tf32=True
    ):
        yield
