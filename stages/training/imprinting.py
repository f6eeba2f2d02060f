"""Imprinting: Gaussians' features and a watermark decoder are optimised jointly until renders show the watermark.

RTWS (the paper's appendix A) fits Gaussians to watermarked photos and tunes the decoder afterwards; as far as measured
(3DGS, the fox: `rtws.md`), hardly anything of the watermark reaches the Gaussians. WateRF (Jang et al., CVPR 2024) and
its successors propagate a decoder's gradient through renders to the scene representation. Here, the decoder learns at
the same time, and also learns to show black for renders from before. Features start with a coarse grain, which a
decoder soon detects. Then the grain fades and the bound on changes of renders decreases, while features and decoder
adapt.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.method import Method
from stages.hiding.rendering import COVER
from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.distortions import random_distortion
from stages.imaging.pictures import Picture, picture_to_tensor, tensor_to_picture
from stages.imaging.windows import random_window
from stages.scene.gaussians import Gaussians
from stages.training.codec import rounded
from stages.training.decoder_tuning import CLEAN, OTHERS, PHOTOS, RENDERS, resized_to, tinted
from stages.training.feature_tuning import attribute_rates
from stages.training.loop import TrainingViews
from stages.training.network import NetworkTraining
from stages.training.optimizer import EPSILON
from stages.training.schedules import decayed


@dataclass(frozen=True)
class ImprintSettings:
    """Each of `iterations` steps uses one training view, and one picture of each kind without the watermark.

    Levels are root mean square differences, in levels of 255. No view's cover may differ by more from its earlier state
    than a bound that starts at `first_level` and decays exponentially to `level` over the first `settling_share` of the
    steps; a message may differ by `message_level`. `feature_rate` and `decoder_rate` are Adam's initial learning rates,
    which decay to `final_rate_share` of themselves. `distorted` adds random distortions, besides the tint, before
    pictures are decoded.
    """

    iterations: int
    seed: int
    level: float
    first_level: float = 20.0
    message_level: float = 0.75
    settling_share: float = 0.7
    feature_rate: float = 5e-3
    decoder_rate: float = 1e-3
    final_rate_share: float = 0.05
    distorted: bool = False


@dataclass(frozen=True)
class ImprintPictures:
    """The pictures that an imprint learns from, for T training views.

    `before` holds the pictures of these views that must stay nearly unchanged, including the cover's; `image` likewise
    the single view that hides an image. `photos` are those of the training views; `others` may have any size;
    `watermark` has the size of the views.
    """

    before: TrainingViews
    photos: Sequence[Picture]
    watermark: Picture
    others: Sequence[Picture] = ()
    image: TrainingViews | None = None


class Imprint(torch.nn.Module):
    """All that is optimised: the decoder, and the Gaussians' appearance attributes."""

    def __init__(self, codec: WatermarkCodec, attributes: Mapping[str, Float[Tensor, "N ..."]]):
        super().__init__()
        self.codec = codec
        self.attributes = torch.nn.ParameterDict(
            {name: torch.nn.Parameter(tensor.detach().clone()) for name, tensor in attributes.items()}
        )


class Imprinting(NetworkTraining):
    """Imprints a watermark on `gaussians`, which must have a grain of the first level, and tunes `codec` to read it.

    `codec` must expect the watermark (`WatermarkCodec.expect`). `clean` are the Gaussians without the grain. Geometry,
    opacities and the method's own networks do not change. All of these are on one device, pictures on the CPU.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        clean: Gaussians,
        method: Method,
        codec: WatermarkCodec,
        pictures: ImprintPictures,
        settings: ImprintSettings,
    ):
        self.imprint = Imprint(codec, gaussians.attributes)
        gaussians.parameters.update(self.imprint.attributes)
        self.gaussians, self.method, self.pictures, self.settings = gaussians, method, pictures, settings
        self.device = gaussians.device
        self.clean = {name: tensor.detach() for name, tensor in clean.attributes.items()}
        self.black = (PHOTOS, CLEAN, OTHERS) if pictures.others else (PHOTOS, CLEAN)
        image = pictures.image.pictures if pictures.image is not None else {}
        self.kept = sorted({*pictures.before.pictures, *image})
        weights = {**dict.fromkeys(self.kept, 1.0), RENDERS: 1.0, **dict.fromkeys(self.black, 1 / len(self.black))}
        rate = settings.decoder_rate
        super().__init__(self.imprint, weights, settings.iterations, rate, rate * settings.final_rate_share)

    def parameter_groups(self) -> list[dict[str, Any]]:
        """The decoder, and each attribute with its own share of the learning rate."""
        rates = attribute_rates(self.method, self.settings.feature_rate)
        groups: list[dict[str, Any]] = [{"params": list(self.imprint.codec.parameters())}]
        for name, attribute in self.imprint.attributes.items():
            share = rates[name] / self.settings.decoder_rate
            groups.append({"params": [attribute], "share": share, "eps": EPSILON})
        return groups

    def allowed(self, name: str, progress: float) -> float:
        """The level by which a picture may differ from its earlier state at `progress` in (0, 1]."""
        settings = self.settings
        if name != COVER:
            return settings.message_level
        return decayed(settings.first_level, settings.level, min(1.0, progress / settings.settling_share))

    def weighed(self, name: str, error: Float[Tensor, ""], progress: float) -> Float[Tensor, ""]:
        """Weigh decoder errors as usual; changes of pictures count by their relative excess over what is allowed."""
        if name not in self.kept:
            return self.weights[name] * error
        return (error / (self.allowed(name, progress) / 255) ** 2 - 1).relu()

    def step(self) -> None:
        """Take one step, then shrink all changes of the features in proportion to the falling level.

        This includes Gaussians that no training view shows: nothing else would fade them, and new views would show
        their grain.
        """
        super().step()
        last, before = (self.allowed(COVER, done / self.iterations) for done in (self.iteration, self.iteration - 1))
        with torch.no_grad():
            for name, attribute in self.imprint.attributes.items():
                attribute.copy_(self.clean[name].lerp(attribute, last / before))

    def errors(self, iteration: int) -> Iterator[dict[str, Float[Tensor, ""]]]:
        """Mean squared errors of pictures against their earlier states, and of decoder outputs against their targets.

        The latter are Eq. 8 with more kinds of pictures. Each view is a group, and so is each picture that must show
        black.
        """
        generator = np.random.default_rng((self.settings.seed, iteration))
        row, photo, clean = (int(drawn) for drawn in generator.integers(len(self.pictures.before.cameras), size=3))
        yield self._of_render(row, generator)
        if self.pictures.image is not None:
            yield self._changed(self.pictures.image, 0)[1]
        for kind, picture in self._without(photo, clean, generator).items():
            yield {kind: self._shown(picture_to_tensor(picture, self.device), generator)}

    def _of_render(self, row: int, generator: np.random.Generator) -> dict[str, Float[Tensor, ""]]:
        """The errors of one view's pictures, and of the watermark that its cover shows."""
        pictures, errors = self._changed(self.pictures.before, row)
        return {**errors, RENDERS: self._shown(pictures[COVER], generator, self.pictures.watermark)}

    def _changed(self, before: TrainingViews, row: int) -> tuple[Mapping[str, Tensor], dict[str, Float[Tensor, ""]]]:
        """The current pictures of one view, and their mean squared differences from their earlier states."""
        truths = before.truths(row, self.device)
        pictures = self.method.render(self.gaussians, before.cameras[row], 1.0, [*truths]).pictures
        return pictures, {name: (pictures[name] - truth).square().mean() for name, truth in truths.items()}

    def _without(self, photo: int, clean: int, generator: np.random.Generator) -> dict[str, Picture]:
        """One picture of each kind that must show black."""
        pictures = {PHOTOS: self.pictures.photos[photo], CLEAN: self.pictures.before.pictures[COVER][clean].numpy()}
        if OTHERS in self.black:
            other = self.pictures.others[int(generator.integers(len(self.pictures.others)))]
            height, width = self.pictures.watermark.shape[:2]
            pictures[OTHERS] = random_window(other, width, height, generator)
        return pictures

    def _shown(
        self, picture: Float[Tensor, "H W 3"], generator: np.random.Generator, watermark: Picture | None = None
    ) -> Float[Tensor, ""]:
        """The mean squared error of the decoder's output against the watermark, or against black."""
        read = self._as_read(picture, generator)
        shown = self.imprint.codec.decode(read)
        if watermark is None:
            return shown.square().mean()
        return (shown - resized_to(read, watermark, self.device)).square().mean()

    def _as_read(self, picture: Float[Tensor, "H W 3"], generator: np.random.Generator) -> Float[Tensor, "h w 3"]:
        """Tint the picture, round it to 8 bits, and distort it if required.

        Without the tint, the imprint would become a tint itself, which everyone sees. Only the tint has a gradient of
        its own; rounding and distortions that keep the size are straight-through.
        """
        picture = tinted(picture, generator)
        if not self.settings.distorted:
            return rounded(picture)
        distorted = picture_to_tensor(random_distortion(tensor_to_picture(picture), generator), self.device)
        return picture + (distorted - picture).detach() if distorted.shape == picture.shape else distorted
