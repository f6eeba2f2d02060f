"""A method whose renders a watermark decoder looks at while it is trained, so that both learn to understand each other.

Not in the paper, which has the features learn from watermarked photos alone. What a codec changes in a picture is tied
to its pixels, no two views agree about it, and Gaussians that fit them all keep next to nothing of it. Here the loss
holds what the decoder shows, too: features and decoder learn together to make it W_cop for renders, and black for the
photos and the clean renders of the same views, and for windows of other photos.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.method import Method
from stages.hiding.rendering import COVER, Rendering
from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.windows import random_window
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.training.codec import batch_of, rounded
from stages.training.schedules import decayed

Pictures = UInt8[np.ndarray, "V H W 3"]

WINDOW = 64
"""Sides in pixels of what the decoder sees of a picture in one step: all it can learn of its surroundings."""

WINDOWS = 2
"""Of each picture in one step."""

HELD = 0.3
"""Share of the iterations before the mark begins to fade. Where it faded from the first on, the decoder took longer to
tell renders from the rest (fox, plain 3DGS: an error under 0.25, that of half the watermark, after 125 and not 75)."""

DECODER = "watermark_decoder"
"""The decoder's name among the networks: neither published nor part of a message's secret."""


class WatermarkReading:
    """`method`, and a penalty on what `codec` shows: of the last render, of the same view's pictures among `negatives`
    (one of each kind a camera), and of windows of `others`, photos of any size.

    The penalty is `weight` times ℓ_cop (Eq. loss_water), in which what should be black counts half in all. The weight
    stays for the first `HELD` of the training and then falls exponentially to `final_share` of itself: a strong mark
    comes first, by which the decoder learns what to look for, and then it fades, as far as the decoder can follow.
    Renders are rounded to bytes first; gradients pass through that as if nothing had been done. Windows follow from
    `seed` and from how far the training is, so that there is no state to keep.
    """

    def __init__(
        self,
        method: Method,
        codec: WatermarkCodec,
        watermark: Picture,
        cameras: Sequence[Camera],
        negatives: Sequence[Pictures],
        others: Sequence[Picture],
        weight: float,
        final_share: float,
        seed: int,
    ):
        self.method, self.codec, self.negatives, self.others = method, codec, negatives, others
        self.watermark = picture_to_tensor(watermark).permute(2, 0, 1)
        self.weight = weight * len(cameras)  # a step sees one view, and takes its share of a penalty
        self.final_share, self.seed = final_share, seed
        self.rows = {id(camera): row for row, camera in enumerate(cameras)}
        self.name, self.settings, self.learning_rates = method.name, method.settings, method.learning_rates
        self.networks: Mapping[str, torch.nn.Module] = {**method.networks, DECODER: codec}
        self.read: Float[Tensor, ""] | None = None

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """The method's own."""
        return self.method.initial_attributes(colors, generator)

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """The method's pictures. Of a training view's cover, what the decoder shows is kept for the penalty."""
        rendering = self.method.render(gaussians, camera, progress, wanted)
        row = self.rows.get(id(camera))
        if row is not None and torch.is_grad_enabled():
            picture = rounded(rendering.pictures[COVER]).permute(2, 0, 1)
            error = self._error(picture, row, np.random.default_rng((self.seed, int(progress * 2**40))))
            self.read = self.weight * decayed(1.0, self.final_share, (progress - HELD) / (1 - HELD)) * error
        return rendering

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """The method's own, and that on what the decoder has shown of the last render."""
        own, read = self.method.penalty(gaussians), self.read
        if read is None:
            return own
        return read if own is None else own + read

    def _error(self, picture: Float[Tensor, "3 H W"], row: int, generator: np.random.Generator) -> Float[Tensor, ""]:
        height, width = (min(WINDOW, side) for side in picture.shape[1:])
        places = [
            tuple(2 * int(generator.integers((side - size) // 2 + 1)) for side, size in zip(sides, sizes, strict=True))
            for sides, sizes in [(picture.shape[1:], (height, width))] * WINDOWS
        ]
        same_view = [picture_to_tensor(pictures[row]).permute(2, 0, 1) for pictures in self.negatives]
        seen = [
            each[:, top : top + height, left : left + width] for each in (picture, *same_view) for top, left in places
        ]
        if self.others:
            chosen = generator.integers(len(self.others), size=WINDOWS).tolist()
            seen += [*batch_of([random_window(self.others[each], width, height, generator) for each in chosen])]
        laps = len(seen) // WINDOWS
        lost = torch.cat([self.codec.lost_window(top, left, height, width) for top, left in places] * laps)
        found = self.codec.decode(torch.stack(seen), lost)
        wanted = torch.stack([self.watermark[:, top : top + height, left : left + width] for top, left in places])
        return (found[:WINDOWS] - wanted).square().mean() + found[WINDOWS:].square().mean()
