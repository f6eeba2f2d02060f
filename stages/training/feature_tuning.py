"""Fine-tuning of what Gaussians look like, and of nothing else: the first half of RTWS (the paper's appendix A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding.method import Method
from stages.hiding.rendering import COVER
from stages.hiding.watermark.codec import WatermarkCodec
from stages.scene.gaussians import GEOMETRY, Gaussians
from stages.training.loop import Training, TrainingSettings, TrainingViews
from stages.training.objectives import FixedView, PictureTerm


def half_watermarked(
    views: TrainingViews, codec: WatermarkCodec, watermark: Float[Tensor, "H W 3"], seed: int
) -> tuple[TrainingViews, tuple[int, ...]]:
    """The views with the watermark in the cover's pictures of a random half of them, and the rows of these, in order.

    Of an odd number of views, the smaller half. The rest, messages among it, is shared with `views`. The codec is where
    the watermark is, pictures stay on the CPU.

    The paper mixes photos with and without the watermark "in a 50% ratio"; both of every view would fit that as well.
    """
    count = len(views.cameras)
    chosen = np.random.default_rng(seed).permutation(count)[: count // 2]
    rows = tuple(sorted(int(row) for row in chosen))
    pictures = [*views.pictures[COVER]]
    for row in rows:
        marked = watermarked(pictures[row].to(watermark.device).float() / 255, codec, watermark)
        pictures[row] = marked.mul(255).round().to(torch.uint8).cpu()
    return replace(views, pictures={**views.pictures, COVER: pictures}), rows


@torch.no_grad()
def watermarked(
    picture: Float[Tensor, "H W 3"], codec: WatermarkCodec, watermark: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """E_w(I, W_cop), clamped to [0, 1]. Raises `ValueError` for odd sides."""
    images, watermarks = (each.permute(2, 0, 1)[None] for each in (picture, watermark))
    return codec.watermark_encoder(images, watermarks)[0].permute(1, 2, 0).clamp(0, 1)


@dataclass(frozen=True)
class FeatureRates:
    """Adam's learning rate of f_i, which falls to `final_share` of itself."""

    features: float
    final_share: float


def feature_training(
    gaussians: Gaussians,
    method: Method,
    views: TrainingViews,
    terms: Sequence[PictureTerm],
    iterations: int,
    rates: FeatureRates,
    seed: int,
    fixed: Sequence[FixedView] = (),
) -> Training:
    """A training that changes f_i alone, or the spherical harmonics of methods without features.

    With learning rates of 0, Adam leaves positions, shapes and opacities as they are to the last bit. A container's
    own networks come from `read_method`, which freezes them. No Gaussian is added or removed. Harmonics learn in the
    proportions of 3DGS's own rates, the constant one as fast as f_i would.
    """
    settings = TrainingSettings(
        iterations=iterations,
        extent=1.0,  # scales positions' rate alone
        seed=seed,
        attribute_rates={**dict.fromkeys(GEOMETRY, 0.0), **attribute_rates(method, rates.features)},
        network_rate=0.0,
        final_rate_share=rates.final_share,
        goes_on=True,
        density=None,
    )
    return Training(gaussians, method, views, terms, settings, fixed)


def refuse_unknown_attributes(gaussians: Gaussians, method: Method, stage: str) -> None:
    """Raise `UserError` where Gaussians hold attributes that the method, as `stage` was given it, knows nothing of.

    So it is with those of the messages of 3DGS+SH where the secret, which names them, is not given.
    """
    unknown = gaussians.attributes.keys() - method.learning_rates.keys()
    if unknown:
        raise UserError(
            "the container holds attributes of messages",
            found=", ".join(sorted(unknown)),
            expected="the secret beside it, which says how many messages these are of",
            remedy=f"give {stage} the input secret: hide.secret",
        )


def attribute_rates(method: Method, rate: float) -> dict[str, float]:
    """`rate` for the attribute of the method that learns fastest, and for the others as much less as by themselves."""
    fastest = max(method.learning_rates.values())
    return {name: rate * own / fastest for name, own in method.learning_rates.items()}
