"""Tuning the watermark decoder D_w: the second half of RTWS (the paper's appendix A, Eq. 8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.distortions import random_distortion, random_recoloring, random_tint
from stages.imaging.pictures import Picture, picture_to_tensor, resize_picture, tensor_to_picture
from stages.imaging.windows import random_window
from stages.training.network import NetworkTraining

RENDERS, PHOTOS = "watermark in renders", "black in photos"
CLEAN, OTHERS = "black in clean renders", "black in other photos"
"""The errors: I_pred should show W_cop, I_gt should show black; the other two are not in the paper."""


@dataclass(frozen=True)
class TuningSettings:
    """Settings of `DecoderTuning`.

    Each of `iterations` steps uses `batch` renders with the watermark, as many windows of other photos, and one picture
    of each other kind. `tinted` applies a random tint to each picture, `distorted` a random distortion or none.
    `black_weight` is the weight of each kind that should show black; that of renders is 1. Each window of other photos
    is the one of `hardest_of` in which the decoder shows most (online hard example mining: Shrivastava et al., 2016).
    """

    iterations: int
    seed: int
    distorted: bool = False
    rate: float = 1e-3
    final_rate: float = 1e-4
    batch: int = 1
    tinted: bool = False
    black_weight: float = 1.0
    hardest_of: int = 1


class DecoderTuning(NetworkTraining):
    """Tunes the decoder of `codec` to show `watermark` in renders and black in everything else.

    `pictures`, by the names of their errors, are all of one size: renders, photos, and whatever else should show black.
    They are on the CPU, the codec on any device. Each kind is traversed in random orders of its own. `others` are lists
    of photos of any size that should show black, too; each list is drawn from equally often. Their random windows are
    always recoloured and distorted, whatever the settings: they stand for all other pictures.
    """

    def __init__(
        self,
        codec: WatermarkCodec,
        watermark: Picture,
        pictures: Mapping[str, UInt8[np.ndarray, "_ H W 3"]],
        settings: TuningSettings,
        others: Sequence[Sequence[Picture]] = (),
    ):
        kinds = [*pictures, OTHERS] if others else [*pictures]
        weights = {kind: 1.0 if kind == RENDERS else settings.black_weight for kind in kinds}
        super().__init__(codec, weights, settings.iterations, settings.rate, settings.final_rate)
        self.codec, self.watermark, self.pictures, self.others = codec, watermark, pictures, others
        self.settings = settings

    def errors(self, iteration: int) -> Iterator[dict[str, Float[Tensor, ""]]]:
        """The two terms of ℓ_cop (Eq. 8) as means over pixels, and the same for other kinds that should show black.

        Each picture is a group.
        """
        generator = np.random.default_rng((self.settings.seed, iteration))
        for kind, pictures in self._batch(iteration, generator).items():
            for picture in pictures:
                yield {kind: self._error(picture, kind == RENDERS) / len(pictures)}
        for _ in range(self.settings.batch if self.others else 0):
            yield {OTHERS: self._error(self._hardest_other(generator), shows=False) / self.settings.batch}

    def _batch(self, iteration: int, generator: np.random.Generator) -> dict[str, list[Picture]]:
        counts = [self.settings.batch if kind == RENDERS else 1 for kind in self.pictures]
        return {
            kind: [self._drawn(kind, number, (iteration - 1) * count + each, generator) for each in range(count)]
            for number, (kind, count) in enumerate(zip(self.pictures, counts, strict=True))
        }

    def _drawn(self, kind: str, number: int, draw: int, generator: np.random.Generator) -> Picture:
        pictures = self.pictures[kind]
        lap, place = divmod(draw, len(pictures))
        order = np.random.default_rng((self.settings.seed, number, lap)).permutation(len(pictures))
        return self._as_read(pictures[order[place]], generator)

    def _hardest_other(self, generator: np.random.Generator) -> Picture:
        drawn = [self._other(generator) for _ in range(self.settings.hardest_of)]
        if len(drawn) == 1:
            return drawn[0]
        with torch.no_grad():
            return drawn[int(np.argmax([self._error(picture, shows=False).item() for picture in drawn]))]

    def _other(self, generator: np.random.Generator) -> Picture:
        height, width = self.watermark.shape[:2]
        photos = self.others[int(generator.integers(len(self.others)))]
        window = random_window(photos[int(generator.integers(len(photos)))], width, height, generator)
        return random_distortion(random_recoloring(window, generator), generator)

    def _as_read(self, picture: Picture, generator: np.random.Generator) -> Picture:
        if self.settings.tinted:
            picture = tensor_to_picture(tinted(picture_to_tensor(picture), generator))
        return random_distortion(picture, generator) if self.settings.distorted else picture

    def _error(self, picture: Picture, shows: bool) -> Float[Tensor, ""]:
        found = decoded(self.codec, picture)
        wanted = resized_to(picture, self.watermark, found.device)
        return (found - wanted).square().mean() if shows else found.square().mean()


def tinted(picture: Float[Tensor, "H W 3"], generator: np.random.Generator) -> Float[Tensor, "H W 3"]:
    """Apply a random tint, with gradients; not clamped."""
    gains, shifts = random_tint(generator)
    return picture * torch.from_numpy(gains).to(picture.device) + torch.from_numpy(shifts).to(picture.device)


def decoded(codec: WatermarkCodec, picture: Picture) -> Float[Tensor, "H W 3"]:
    """Run D_w on one 8-bit picture with even sides; the result is unclamped, on the codec's device."""
    return codec.decode(picture_to_tensor(picture, codec.device))


def resized_to(
    picture: Picture | Float[Tensor, "H W 3"], watermark: Picture, device: torch.device | str = "cpu"
) -> Float[Tensor, "H W 3"]:
    """The watermark, resized to a picture's size, in [0, 1]."""
    return picture_to_tensor(resize_picture(watermark, picture.shape[1], picture.shape[0]), device)
