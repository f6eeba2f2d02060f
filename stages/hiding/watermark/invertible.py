"""An invertible network: coupling blocks, each of which changes one half of its input by what it reads in the other.

Blocks are affine couplings (Dinh et al., 2017) as HiNet (Jing et al., 2021) arranges them for hiding pictures: the
cover takes in the watermark by addition, the watermark takes in the cover by a scale and a shift.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

LARGEST_LOG_SCALE = 1.0
"""Scales lie between 1/e and e: a network of a dozen blocks stays well-conditioned both ways."""

SLOPE = 0.2
"""Of the rectifiers where they are negative."""

Half = Float[Tensor, "B C H W"]


class DenseConvolutions(torch.nn.Module):
    """Three 3 x 3 convolutions, each of which sees the input and all outputs before it; the last starts at zero.

    Once they `see_whole_pictures`, the means over the picture of what the first two put out shift what the next one
    puts out, everywhere alike.
    """

    def __init__(self, inputs: int, outputs: int, width: int):
        super().__init__()
        self.first = torch.nn.Conv2d(inputs, width, 3, padding=1)
        self.second = torch.nn.Conv2d(inputs + width, width, 3, padding=1)
        self.last = torch.nn.Conv2d(inputs + 2 * width, outputs, 3, padding=1)
        self.overall: torch.nn.ParameterList | None = None
        torch.nn.init.zeros_(self.last.weight)
        torch.nn.init.zeros_(self.last.bias)  # type: ignore[arg-type]  # it has one

    def forward(self, values: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D H W"]:
        """The last convolution's output, not rectified."""
        rectify = torch.nn.functional.leaky_relu
        first = rectify(self.first(values), SLOPE)
        seen = torch.cat([values, first], dim=1)
        second = rectify(self.second(seen) + self._shift(0, first), SLOPE)
        seen = torch.cat([seen, second], dim=1)
        return self.last(seen) + self._shift(1, second)

    def see_whole_pictures(self) -> None:
        """Begin to; the shifts that the means lead to start at zero."""
        width, outputs = self.first.out_channels, self.last.out_channels
        self.overall = torch.nn.ParameterList(torch.zeros(size, width) for size in (width, outputs))

    def _shift(self, number: int, seen: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D 1 1"] | float:
        if self.overall is None:
            return 0.0
        return (seen.mean(dim=(2, 3)) @ self.overall[number].T)[..., None, None]


class CouplingBlock(torch.nn.Module):
    """cover' = cover + φ(watermark), watermark' = watermark · exp(s(cover')) + η(cover'); begins as the identity."""

    def __init__(self, channels: int, width: int):
        super().__init__()
        self.channels = channels
        self.added = DenseConvolutions(channels, channels, width)
        self.scaled_and_shifted = DenseConvolutions(channels, 2 * channels, width)

    def forward(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Both halves, one block on."""
        cover = cover + self.added(watermark)
        log_scale, shift = self._scale_and_shift(cover)
        return cover, watermark * log_scale.exp() + shift

    def inverse(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Both halves, one block back."""
        log_scale, shift = self._scale_and_shift(cover)
        watermark = (watermark - shift) * (-log_scale).exp()
        return cover - self.added(watermark), watermark

    def _scale_and_shift(self, cover: Half) -> tuple[Half, Half]:
        log_scale, shift = self.scaled_and_shifted(cover).chunk(2, dim=1)
        return LARGEST_LOG_SCALE * torch.tanh(log_scale), shift


class InvertibleNetwork(torch.nn.Module):
    """`blocks` coupling blocks on two halves of `channels` channels. First weights come from torch's generator.

    Invertible it stays with `see_whole_pictures`: what couplings read of one half is not what they change.
    """

    def __init__(self, channels: int, blocks: int, width: int):
        super().__init__()
        self.blocks = torch.nn.ModuleList([CouplingBlock(channels, width) for _ in range(blocks)])

    def see_whole_pictures(self) -> None:
        """As `DenseConvolutions` do: squeeze-and-excitation (Hu et al., 2018) that adds, where theirs multiplies."""
        for module in self.modules():
            if isinstance(module, DenseConvolutions):
                module.see_whole_pictures()

    def forward(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Through all blocks."""
        for block in self.blocks:
            cover, watermark = block(cover, watermark)
        return cover, watermark

    def inverse(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """The halves that `forward` made these of, up to rounding."""
        for block in reversed(self.blocks):
            cover, watermark = block.inverse(cover, watermark)  # type: ignore[operator]  # modules are typed as tensors
        return cover, watermark
