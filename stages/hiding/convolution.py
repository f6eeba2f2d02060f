"""A convolution whose training on the CPU takes half (64 channels) to four fifths (16) of what torch's does."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.convolution import can_convolve, convolve
from stages.hiding.tensor_float import convolve_rounded


class Convolution(torch.nn.Conv2d):
    """`Conv2d` of stride 1 that keeps the picture's size, for an odd `kernel_size`; the same weights, and the same
    pictures and gradients up to rounding. Fastest with channels last, as the rasterizer leaves feature maps."""

    bias: Tensor  # these all have one

    def __init__(self, inputs: int, outputs: int, kernel_size: int):
        super().__init__(inputs, outputs, kernel_size, padding=kernel_size // 2)

    def forward(
        self, values: Float[Tensor, "B C H W"], rectified: bool = False, rounded: bool = False
    ) -> Float[Tensor, "B D H W"]:
        """With zeros beyond the edges; followed by ReLU where `rectified`; on a CUDA device in TF32 where `rounded`."""
        if can_convolve(values, self.weight) and not torch.is_autocast_enabled(values.device.type):
            return convolve(values, self.weight, self.bias, rectified)
        if rounded and values.device.type != "cpu":
            convolved = convolve_rounded(values, self.weight, self.bias)
        else:
            convolved = super().forward(values)  # what autocast rounds it has to see itself
        return torch.relu(convolved) if rectified else convolved
