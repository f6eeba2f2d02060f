"""A convolution that trains on the CPU in half (64 channels) to four fifths (16 channels) of the time torch's takes."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.convolution import can_convolve, convolve
from stages.hiding.tensor_float import convolve_rounded


class Convolution(torch.nn.Conv2d):
    """A `Conv2d` with stride 1 that keeps the picture's size; `kernel_size` must be odd.

    Weights are those of `Conv2d`; outputs and gradients agree with it up to rounding. It is fastest with channels last,
    the layout in which the rasterizer leaves feature maps.
    """

    bias: Tensor  # never None here

    def __init__(self, inputs: int, outputs: int, kernel_size: int):
        super().__init__(inputs, outputs, kernel_size, padding=kernel_size // 2)

    def forward(
        self, values: Float[Tensor, "*batch C H W"], rectified: bool = False, rounded: bool = False
    ) -> Float[Tensor, "*batch D H W"]:
        """Convolve with zero padding. `rectified` applies a ReLU; `rounded` uses TF32 on a CUDA device."""
        if can_convolve(values, self.weight) and not torch.is_autocast_enabled(values.device.type):
            return convolve(values, self.weight, self.bias, rectified)
        if rounded and values.device.type != "cpu":
            convolved = convolve_rounded(values, self.weight, self.bias)
        else:
            convolved = super().forward(values)  # under autocast, torch must see the operation itself
        return torch.relu(convolved) if rectified else convolved
