"""An invertible network of coupling blocks, each of which changes one half of its input depending on the other half.

Blocks are affine couplings (Dinh et al., 2017), arranged as HiNet (Jing et al., 2021) does to hide pictures: the cover
absorbs the watermark by addition, the watermark absorbs the cover by a scale and a shift.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

LARGEST_LOG_SCALE = 1.0
"""Scales are between 1/e and e: a network of a dozen blocks stays well-conditioned in both directions."""

SLOPE = 0.2
"""Slope of the leaky ReLUs for negative values."""

Half = Float[Tensor, "B C H W"]


class DenseConvolutions(torch.nn.Module):
    """Three 3 x 3 convolutions, each of which sees the input and all previous outputs; the last starts at zero.

    After `see_whole_pictures`, the channel means of the first and the second output over the picture shift the next
    output, equally at all pixels.
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
        """The output of the last convolution, without activation."""
        rectify = torch.nn.functional.leaky_relu
        first = rectify(self.first(values), SLOPE)
        seen = torch.cat([values, first], dim=1)
        second = rectify(self.second(seen) + self._shift(0, first), SLOPE)
        seen = torch.cat([seen, second], dim=1)
        return self.last(seen) + self._shift(1, second)

    def see_whole_pictures(self) -> None:
        """Add the path from channel means to shifts, with weights that start at zero."""
        width, outputs = self.first.out_channels, self.last.out_channels
        self.overall = torch.nn.ParameterList(torch.zeros(size, width) for size in (width, outputs))

    def _shift(self, number: int, seen: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D 1 1"] | float:
        if self.overall is None:
            return 0.0
        return (seen.mean(dim=(2, 3)) @ self.overall[number].T)[..., None, None]


class CouplingBlock(torch.nn.Module):
    """cover' = cover + φ(watermark), watermark' = watermark · exp(s(cover')) + η(cover'); starts as the identity."""

    def __init__(self, channels: int, width: int):
        super().__init__()
        self.channels = channels
        self.added = DenseConvolutions(channels, channels, width)
        self.scaled_and_shifted = DenseConvolutions(channels, 2 * channels, width)

    def forward(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Transform both halves."""
        cover = cover + self.added(watermark)
        log_scale, shift = self._scale_and_shift(cover)
        return cover, watermark * log_scale.exp() + shift

    def inverse(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Undo `forward`."""
        log_scale, shift = self._scale_and_shift(cover)
        watermark = (watermark - shift) * (-log_scale).exp()
        return cover - self.added(watermark), watermark

    def _scale_and_shift(self, cover: Half) -> tuple[Half, Half]:
        log_scale, shift = self.scaled_and_shifted(cover).chunk(2, dim=1)
        return LARGEST_LOG_SCALE * torch.tanh(log_scale), shift


class InvertibleNetwork(torch.nn.Module):
    """`blocks` coupling blocks on two halves of `channels` channels. Initial weights are drawn from torch's generator.

    It remains invertible after `see_whole_pictures`, since a coupling never reads the half that it changes.
    """

    def __init__(self, channels: int, blocks: int, width: int):
        super().__init__()
        self.blocks = torch.nn.ModuleList([CouplingBlock(channels, width) for _ in range(blocks)])

    def see_whole_pictures(self) -> None:
        """Apply to all `DenseConvolutions`: an additive variant of squeeze-and-excitation (Hu et al., 2018)."""
        for module in self.modules():
            if isinstance(module, DenseConvolutions):
                module.see_whole_pictures()

    def forward(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Transform both halves by all blocks."""
        for block in self.blocks:
            cover, watermark = block(cover, watermark)
        return cover, watermark

    def inverse(self, cover: Half, watermark: Half) -> tuple[Half, Half]:
        """Undo `forward`, up to rounding."""
        for block in reversed(self.blocks):
            cover, watermark = block.inverse(cover, watermark)  # type: ignore[operator]  # modules are typed as tensors
        return cover, watermark
