"""Training a watermark codec: random windows of photos are hidden in each other and revealed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.image import filling
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.windows import random_window
from stages.training.network import NetworkTraining

Pictures = Float[Tensor, "B 3 H W"]

MARKED, FOUND = "watermarked picture", "watermark"
"""The two errors: of the watermarked picture relative to the original, and of the watermark revealed from it."""

RATE, FINAL_RATE = 1e-3, 1e-4
"""Adam's learning rate at the start and at the end."""


@dataclass(frozen=True)
class CodecSettings:
    """Each of `iterations` steps uses `batch` windows of `window` x `window` pixels.

    `fidelity_weight` is the weight of the watermarked picture's squared error; that of the watermark's is 1.
    `given_share` of the watermarks are the given pictures, the others are windows of photos. Before decoding, noise
    with a standard deviation of up to `largest_noise`, in [0, 1], is added to watermarked pictures.
    """

    iterations: int
    seed: int
    batch: int = 4
    window: int = 64
    fidelity_weight: float = 2.0
    given_share: float = 0.25
    largest_noise: float = 0.01


class CodecTraining(NetworkTraining):
    """Trains a codec on `photos`, at least one; without `watermarks`, only windows of photos are hidden.

    Photos and watermarks are on the CPU, the codec on any device.
    """

    needs_less_memory = "choose a smaller batch or window"

    def __init__(
        self, codec: WatermarkCodec, photos: Sequence[Picture], watermarks: Sequence[Picture], settings: CodecSettings
    ):
        weights = {MARKED: settings.fidelity_weight, FOUND: 1.0}
        super().__init__(codec, weights, settings.iterations, RATE, FINAL_RATE)
        self.codec, self.photos, self.watermarks, self.settings = codec, photos, watermarks, settings

    def errors(self, iteration: int) -> Iterator[dict[str, Float[Tensor, ""]]]:
        """Hide a batch, round it to bytes, add noise, and reveal the watermarks."""
        images, watermarks, noise = self._batch(iteration)
        marked = self.codec.watermark_encoder(images, watermarks)
        found = self.codec.watermark_decoder(rounded(marked) + noise)
        yield {MARKED: (marked - images).square().mean(), FOUND: (found - watermarks).square().mean()}

    def _batch(self, iteration: int) -> tuple[Pictures, Pictures, Pictures]:
        settings, generator = self.settings, np.random.default_rng((self.settings.seed, iteration))
        images = batch_of([self._window(generator) for _ in range(settings.batch)])
        watermarks = batch_of([self._watermark(generator) for _ in range(settings.batch)])
        deviations = generator.uniform(0, settings.largest_noise, (settings.batch, 1, 1, 1))
        noise = torch.from_numpy(generator.normal(0, deviations, tuple(images.shape))).float()
        device = self.codec.device
        return images.to(device), watermarks.to(device), noise.to(device)

    def _watermark(self, generator: np.random.Generator) -> Picture:
        side = self.settings.window
        if not self.watermarks or generator.uniform() >= self.settings.given_share:
            return self._window(generator)
        return filling(self.watermarks[int(generator.integers(len(self.watermarks)))], side, side)

    def _window(self, generator: np.random.Generator) -> Picture:
        side = self.settings.window
        return random_window(self.photos[int(generator.integers(len(self.photos)))], side, side, generator)


def batch_of(pictures: Sequence[Picture]) -> Pictures:
    """A batch, in [0, 1], of pictures of equal size."""
    return picture_to_tensor(np.stack(pictures)).permute(0, 3, 1, 2).contiguous()


def rounded(pictures: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Clamp to [0, 1] and round to multiples of 1/255, as files do, with a straight-through gradient."""
    return pictures + ((pictures.clamp(0, 1) * 255).round() / 255 - pictures).detach()
