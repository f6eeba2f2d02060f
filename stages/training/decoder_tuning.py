"""The tuning of the watermark decoder D_w: the second half of RTWS (the paper's appendix A, Eq. loss_water)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.distortions import random_distortion
from stages.imaging.pictures import Picture, picture_to_tensor, resize_picture
from stages.training.network import NetworkTraining

RENDERS, PHOTOS = "watermark in renders", "black in photos"
CLEAN = "black in clean renders"
"""The errors: I_pred that should show W_cop, I_gt that should show black, and what the paper does not ask for."""


@dataclass(frozen=True)
class TuningSettings:
    """Each of `iterations` steps sees one picture of every kind; `distorted`: after a random distortion, or none."""

    iterations: int
    seed: int
    distorted: bool = False
    rate: float = 1e-3
    final_rate: float = 1e-4


class DecoderTuning(NetworkTraining):
    """`pictures` by the names of their errors, all of one size: renders, photos, and what else should show black.

    Each kind goes through its pictures in random orders of its own.
    """

    def __init__(
        self,
        codec: WatermarkCodec,
        watermark: Picture,
        pictures: Mapping[str, UInt8[np.ndarray, "K H W 3"]],
        settings: TuningSettings,
    ):
        super().__init__(codec, dict.fromkeys(pictures, 1.0), settings.iterations, settings.rate, settings.final_rate)
        self.codec, self.watermark, self.pictures, self.settings = codec, watermark, pictures, settings

    def errors(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """ℓ_cop (Eq. loss_water), its two terms apart, as means over pixels; and the same for clean renders."""
        generator = np.random.default_rng((self.settings.seed, iteration))
        return {
            kind: self._error(self._drawn(kind, number, iteration, generator), shows=kind == RENDERS)
            for number, kind in enumerate(self.pictures)
        }

    def _drawn(self, kind: str, number: int, iteration: int, generator: np.random.Generator) -> Picture:
        pictures = self.pictures[kind]
        lap, place = divmod(iteration - 1, len(pictures))
        order = np.random.default_rng((self.settings.seed, number, lap)).permutation(len(pictures))
        picture: Picture = pictures[order[place]]
        return random_distortion(picture, generator) if self.settings.distorted else picture

    def _error(self, picture: Picture, shows: bool) -> Float[Tensor, ""]:
        found = decoded(self.codec, picture)
        wanted = picture_to_tensor(resize_picture(self.watermark, picture.shape[1], picture.shape[0]))
        return (found - wanted).square().mean() if shows else found.square().mean()


def decoded(codec: WatermarkCodec, picture: Picture) -> Float[Tensor, "H W 3"]:
    """D_w of one 8-bit picture of even sides, unclamped."""
    return codec.watermark_decoder(picture_to_tensor(picture).permute(2, 0, 1)[None])[0].permute(1, 2, 0)
