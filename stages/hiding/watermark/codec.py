"""The watermark encoder E_w and decoder D_w: one invertible network, run forward to hide and backward to reveal.

It follows EditGuard (Zhang et al., 2024), which the paper names, and HiNet before it: the network acts on the wavelet
coefficients of cover and watermark. One of its two outputs is the watermarked picture; the other is discarded.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.watermark.invertible import InvertibleNetwork
from stages.hiding.watermark.wavelet import BANDS, haar, inverse_haar

COLORS = 3

Picture = Float[Tensor, "H W 3"]
Pictures = Float[Tensor, "B 3 H W"]


class WatermarkCodec(torch.nn.Module):
    """E_w and D_w of the paper's appendix. Pictures are sRGB in [0, 1] with even sides, unclamped.

    Encoder and decoder share their weights. `lost [1, 12, h, w]` replaces the discarded output when the network runs
    backward: zeros, until the decoder is tuned to one watermark (`expect`). Initial weights are drawn from torch's
    generator; a new codec hides nothing.
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
        """The device of the codec's weights."""
        return self.lost.device

    @property
    def settings(self) -> Mapping[str, int | bool]:
        """The constructor's arguments for a codec like this one."""
        return {"blocks": self.blocks, "width": self.width, "sees_whole_pictures": self.sees_whole_pictures}

    def watermark_encoder(self, images: Pictures, watermarks: Pictures) -> Pictures:
        """Embed the watermarks in the images. Raises `ValueError` for odd sides."""
        marked, _ = self.network(haar(images), haar(watermarks))
        return inverse_haar(marked)

    def watermark_decoder(self, images: Pictures) -> Pictures:
        """Reveal the watermarks in the images; the result is arbitrary for images without one.

        Raises `ValueError` for odd sides.
        """
        size = [side // 2 for side in images.shape[-2:]]
        lost: Pictures = self.lost
        if list(lost.shape[-2:]) != size:  # on a GPU, what gives the same bits each time is slow, even for equal sizes
            lost = torch.nn.functional.interpolate(lost, size, mode="bilinear", align_corners=False)
        coefficients = haar(images)
        _, watermarks = self.network.inverse(coefficients, lost.expand_as(coefficients))
        return inverse_haar(watermarks)

    def encode(self, picture: Picture, watermark: Picture) -> Picture:
        """Embed a watermark in one picture: see `watermark_encoder`."""
        return _one_picture(self.watermark_encoder(_batch_of(picture), _batch_of(watermark)))

    def decode(self, picture: Picture) -> Picture:
        """Reveal the watermark in one picture: see `watermark_decoder`."""
        return _one_picture(self.watermark_decoder(_batch_of(picture)))

    def expect(self, watermark: Picture) -> None:
        """Prepare to tune the decoder to one watermark, whose coefficients replace the discarded output.

        All weights can learn afterwards. A codec that was already tuned to a watermark of this size keeps its
        coefficients, which its weights have adapted to. The paper tunes D_w until it shows either one picture or black.
        Convolutions see only a neighbourhood and cannot memorise a larger picture; with this initialisation they only
        have to pass or suppress it. Such a decoder need not reveal what its encoder would hide.
        """
        self.requires_grad_(True)
        coefficients = haar(_batch_of(watermark)).detach().clone()
        if coefficients.shape != self.lost.shape:
            self.lost = torch.nn.Parameter(coefficients)

    def see_whole_pictures(self) -> None:
        """Add a path that sees the whole picture: the trace of a watermark may be too faint to be detected locally.

        The new weights start at zero, so that nothing changes until they are trained. No effect if the path is already
        there.
        """
        if not self.sees_whole_pictures:
            self.sees_whole_pictures = True
            self.network.see_whole_pictures()
            self.network.to(self.device)


def _batch_of(picture: Picture) -> Pictures:
    return picture.permute(2, 0, 1)[None]


def _one_picture(pictures: Pictures) -> Picture:
    return pictures[0].permute(1, 2, 0)


def new_codec(blocks: int, width: int, seed: int) -> WatermarkCodec:
    """A codec whose initial weights follow from the seed; the state of torch's global generator is preserved."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return WatermarkCodec(blocks, width)
