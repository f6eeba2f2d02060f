"""The watermark encoder E_w and decoder D_w: one invertible network, run forward to hide and backward to reveal.

In the manner of EditGuard (Zhang et al., 2024), which the paper names, and of HiNet before it: the network acts on
wavelet coefficients of cover and watermark; of its two outputs one is the watermarked picture, the other is lost.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.watermark.invertible import InvertibleNetwork
from stages.hiding.watermark.wavelet import BANDS, haar, inverse_haar

COLORS = 3

Pictures = Float[Tensor, "B 3 H W"]


class WatermarkCodec(torch.nn.Module):
    """E_w and D_w of the paper's appendix. Pictures are sRGB in [0, 1] with even sides, channels first, unclamped.

    Both share their weights. `lost [1, 12, h, w]` stands in for what is lost when the network runs backward: zeros,
    until the decoder is tuned to one watermark (`expect`). First weights come from torch's generator; a new codec
    hides nothing.
    """

    def __init__(self, blocks: int, width: int, sees_whole_pictures: bool = False):
        super().__init__()
        self.blocks, self.width, self.sees_whole_pictures = blocks, width, False
        self.network = InvertibleNetwork(BANDS * COLORS, blocks, width)
        self.lost = torch.nn.Parameter(torch.zeros(1, BANDS * COLORS, 1, 1), requires_grad=False)
        if sees_whole_pictures:
            self.see_whole_pictures()

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.lost.device

    @property
    def settings(self) -> Mapping[str, int | bool]:
        """What a codec of this size is made with."""
        return {"blocks": self.blocks, "width": self.width, "sees_whole_pictures": self.sees_whole_pictures}

    def watermark_encoder(self, images: Pictures, watermarks: Pictures) -> Pictures:
        """The images with the watermarks in them. Raises `ValueError` for odd sides."""
        marked, _ = self.network(haar(images), haar(watermarks))
        return inverse_haar(marked)

    def watermark_decoder(self, images: Pictures) -> Pictures:
        """The watermarks in the images; of images without one, whatever the decoder makes of them."""
        size = [side // 2 for side in images.shape[-2:]]
        lost = torch.nn.functional.interpolate(self.lost, size, mode="bilinear", align_corners=False)
        coefficients = haar(images)
        _, watermarks = self.network.inverse(coefficients, lost.expand_as(coefficients))
        return inverse_haar(watermarks)

    def expect(self, watermark: Float[Tensor, "3 H W"]) -> None:
        """Make it a decoder of this one watermark, whose coefficients stand in for what is lost; all of it can learn.

        One that was tuned to a watermark of this size goes on from what stands in by now: its weights are used to it.
        The paper tunes D_w until it shows one picture or black. Convolutions see no more than their surroundings, and
        cannot know by heart a picture that is larger: with this start they only have to let it pass or hold it back.
        What its encoder would hide, such a decoder need not find.
        """
        self.requires_grad_(True)
        coefficients = haar(watermark[None]).detach().clone()
        if coefficients.shape != self.lost.shape:
            self.lost = torch.nn.Parameter(coefficients)

    def see_whole_pictures(self) -> None:
        """Begin to decide by the whole picture: what a mark leaves at one place may be too faint to be told there.

        Nothing changes until it learns, by weights that start at zero. A codec that does already stays as it is.
        """
        if not self.sees_whole_pictures:
            self.sees_whole_pictures = True
            self.network.see_whole_pictures()
            self.network.to(self.device)


def new_codec(blocks: int, width: int, seed: int) -> WatermarkCodec:
    """A codec whose first weights follow from the seed; torch's own generator stays as it was."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return WatermarkCodec(blocks, width)
