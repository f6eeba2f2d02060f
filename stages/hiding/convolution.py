"""A convolution of channels last whose training does not wait for the gradient of its weights.

Channels last is how the rasterizer leaves feature maps, and the faster format forward and for the gradient of the
input. On processors without AVX-512 oneDNN has no good kernel for the gradient of the weights in it: of 64 to 64
channels, 3 x 3, at 200 x 132 pixels it takes 157 ms, seven times as long as that of the input, and 52 ms where all is
converted to channels first for it, the conversions included (Zen 3, one core). In GS-Hider that is most of a training.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

SLOW_WEIGHTS = "AVX2"
"""The capability, as torch names it, whose gradients of weights are better taken with channels first."""


def converts_for_weights() -> bool:
    """Whether gradients of weights are taken with channels first on this processor."""
    return torch.backends.cpu.get_cpu_capability() == SLOW_WEIGHTS


class Convolution(torch.nn.Conv2d):
    """`Conv2d` of stride 1 that keeps the picture's size, for an odd `kernel_size`; the same weights, and the same
    pictures. Gradients of the weights differ by the order of their sums."""

    def __init__(self, inputs: int, outputs: int, kernel_size: int):
        super().__init__(inputs, outputs, kernel_size, padding=kernel_size // 2)

    def forward(self, values: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D H W"]:
        """With zeros beyond the edges."""
        if not (self._has_slow_weights() and values.device.type == "cpu" and converts_for_weights()):
            return super().forward(values)
        convolved: Tensor = _ChannelsFirstForWeights.apply(values, self.weight, self.bias, self.padding)
        return convolved

    def _has_slow_weights(self) -> bool:
        """Single pixels are a product of matrices in either format; what autocast rounds it has to see itself."""
        return self.kernel_size != (1, 1) and self.weight.requires_grad and not torch.is_autocast_enabled("cpu")


class _ChannelsFirstForWeights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, weight: Tensor, bias: Tensor, padding: tuple[int, int]) -> Tensor:
        ctx.save_for_backward(values, weight)
        ctx.padding = padding
        return torch.nn.functional.conv2d(values, weight, bias, padding=padding)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        values, weight = ctx.saved_tensors
        of_values, of_weight, of_bias, _ = ctx.needs_input_grad
        found: Tensor | None = None
        if of_values:
            found = _gradients(gradient, values, weight, ctx.padding, (True, False, False))[0]
        _, weights, biases = _gradients(
            gradient.contiguous(), values.contiguous(), weight.contiguous(), ctx.padding, (False, of_weight, of_bias)
        )
        return found, weights, biases, None


def _gradients(
    gradient: Tensor, values: Tensor, weight: Tensor, padding: tuple[int, int], wanted: tuple[bool, bool, bool]
) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
    """Of input, weights and bias, as far as wanted."""
    found: tuple[Tensor | None, Tensor | None, Tensor | None] = torch.ops.aten.convolution_backward(
        gradient, values, weight, [len(weight)], (1, 1), padding, (1, 1), False, (0, 0), 1, wanted
    )
    return found
