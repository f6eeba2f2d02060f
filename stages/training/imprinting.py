"""An imprint: Gaussians' features and a watermark decoder that are tuned together until renders show the watermark.

RTWS (the paper's appendix A) fits Gaussians to watermarked photos and tunes the decoder afterwards; what such photos
carry hardly reaches the Gaussians. WateRF (Jang et al., CVPR 2024) and those after it send the gradient of a decoder
through renders to what is rendered. Here the decoder learns at the same time, and what else it must show black for:
renders from before the imprint above all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.method import Method
from stages.hiding.rendering import COVER
from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.distortions import random_distortion
from stages.imaging.pictures import Picture, picture_to_tensor, resize_picture, tensor_to_picture
from stages.imaging.windows import random_window
from stages.scene.gaussians import Gaussians
from stages.training.decoder_tuning import CLEAN, PHOTOS, RENDERS
from stages.training.feature_tuning import attribute_rates
from stages.training.loop import TrainingViews
from stages.training.network import NetworkTraining
from stages.training.objectives import FixedView
from stages.training.optimizer import EPSILON
from stages.training.schedules import decayed

OTHERS = "black in other photos"
"""The error beside those of `decoder_tuning`."""


@dataclass(frozen=True)
class ImprintSettings:
    """Each of `iterations` steps sees one training view and one picture of every kind without the watermark.

    `feature_rate` and `decoder_rate` are Adam's first, which fall to `final_rate_share` of themselves. The weight of
    the watermark's errors beside the cover's falls from `watermark_weight` to `final_watermark_weight` in the first
    `settling_share` of the steps: features and decoder first agree on a mark, then the mark becomes faint. `distorted`:
    pictures are distorted at random before they are read. λ is the messages'.
    """

    iterations: int
    seed: int
    feature_rate: float
    decoder_rate: float = 1e-3
    final_rate_share: float = 0.1
    watermark_weight: float = 0.03
    final_watermark_weight: float = 0.002
    settling_share: float = 0.6
    lambda_message: float = 0.1
    distorted: bool = False


@dataclass(frozen=True)
class ImprintPictures:
    """What an imprint learns from: T training views with their pictures (the cover's, and messages' if any), renders of
    the same views from before, the watermark at their size, other photos of any size, and views that hide an image.
    """

    views: TrainingViews
    clean: UInt8[np.ndarray, "T H W 3"]
    watermark: Picture
    others: Sequence[Picture] = ()
    fixed: Sequence[FixedView] = ()


class Imprint(torch.nn.Module):
    """All that learns: the decoder, and those attributes of the Gaussians that say what they look like."""

    def __init__(self, codec: WatermarkCodec, attributes: Mapping[str, Float[Tensor, "N ..."]]):
        super().__init__()
        self.codec = codec
        self.attributes = torch.nn.ParameterDict(
            {name: torch.nn.Parameter(tensor.detach().clone()) for name, tensor in attributes.items()}
        )


class Imprinting(NetworkTraining):
    """`gaussians` become those with the imprint; `codec`, which expects the watermark, their decoder.

    Geometry, opacities and the method's own networks stay as they are.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        method: Method,
        codec: WatermarkCodec,
        pictures: ImprintPictures,
        settings: ImprintSettings,
    ):
        self.imprint = Imprint(codec, gaussians.attributes)
        gaussians.parameters.update(self.imprint.attributes)
        self.gaussians, self.method, self.pictures, self.settings = gaussians, method, pictures, settings
        self.black = {PHOTOS: 1.0, CLEAN: 1.0, **({OTHERS: 1.0} if pictures.others else {})}
        hidden = [*pictures.views.pictures.keys() - {COVER}, *(view.term.picture for view in pictures.fixed)]
        weights = {COVER: 1.0, **dict.fromkeys(sorted(hidden), settings.lambda_message), RENDERS: 1.0}
        weights |= {kind: 1 / len(self.black) for kind in self.black}
        rate = settings.decoder_rate
        super().__init__(self.imprint, weights, settings.iterations, rate, rate * settings.final_rate_share)

    def parameter_groups(self) -> list[dict[str, Any]]:
        """The decoder, and each attribute at its own share of the rate."""
        rates = attribute_rates(self.method, self.settings.feature_rate)
        groups: list[dict[str, Any]] = [{"params": list(self.imprint.codec.parameters())}]
        for name, attribute in self.imprint.attributes.items():
            groups.append(
                {"params": [attribute], "share": rates[name] / self.settings.decoder_rate, "eps": EPSILON},
            )
        return groups

    def weight(self, name: str, progress: float) -> float:
        """That of the watermark's errors falls."""
        settings, own = self.settings, self.weights[name]
        if name != RENDERS and name not in self.black:
            return own
        settled = min(1.0, progress / settings.settling_share)
        return own * decayed(settings.watermark_weight, settings.final_watermark_weight, settled)

    def errors(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """Mean squares: the cover's and the messages' beside their truths, and what the decoder shows beside what it
        should (Eq. loss_water, with more kinds of pictures)."""
        generator = np.random.default_rng((self.settings.seed, iteration))
        views = self.pictures.views
        row, photo, clean = generator.integers(len(views.cameras), size=3)
        truths = views.truths(row)
        rendering = self.method.render(self.gaussians, views.cameras[row], 1.0, [*truths])
        errors = {name: (rendering.pictures[name] - truth).square().mean() for name, truth in truths.items()}
        errors |= {view.term.picture: self._seen(view) for view in self.pictures.fixed}
        errors[RENDERS] = self._shown(rendering.pictures[COVER], generator, self.pictures.watermark)
        for kind, picture in self._without(photo, clean, generator).items():
            errors[kind] = self._shown(picture_to_tensor(picture), generator)
        return errors

    def _seen(self, view: FixedView) -> Float[Tensor, ""]:
        rendering = self.method.render(self.gaussians, view.camera, 1.0, [view.term.picture])
        return (rendering.pictures[view.term.picture] - view.truth.float() / 255).square().mean()

    def _without(self, photo: int, clean: int, generator: np.random.Generator) -> dict[str, Picture]:
        """One picture of every kind that must show black."""
        pictures = {PHOTOS: self.pictures.views.pictures[COVER][photo].numpy(), CLEAN: self.pictures.clean[clean]}
        if OTHERS in self.black:
            other = self.pictures.others[int(generator.integers(len(self.pictures.others)))]
            height, width = self.pictures.watermark.shape[:2]
            pictures[OTHERS] = random_window(other, width, height, generator)
        return pictures

    def _shown(
        self, picture: Float[Tensor, "H W 3"], generator: np.random.Generator, watermark: Picture | None = None
    ) -> Float[Tensor, ""]:
        """How far what the decoder shows is from the watermark, or from black."""
        read = self._as_read(picture, generator)
        shown = self.imprint.codec.watermark_decoder(read.permute(2, 0, 1)[None])[0].permute(1, 2, 0)
        if watermark is None:
            return shown.square().mean()
        return (shown - picture_to_tensor(resize_picture(watermark, read.shape[1], read.shape[0]))).square().mean()

    def _as_read(self, picture: Float[Tensor, "H W 3"], generator: np.random.Generator) -> Float[Tensor, "h w 3"]:
        """In 8 bits, and distorted where that is wanted. Gradients pass as if nothing had been done."""
        written = tensor_to_picture(picture)
        if self.settings.distorted:
            written = random_distortion(written, generator)
        if written.shape != picture.shape:
            return picture_to_tensor(written)
        return picture + (picture_to_tensor(written) - picture).detach()
