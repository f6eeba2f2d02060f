"""Fine-tuning only the appearance of Gaussians: the first half of RTWS (the paper's appendix A)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    views: TrainingViews,
    codec: WatermarkCodec,
    watermark: Float[Tensor, "H W 3"],
    seed: int,
    after_each: Callable[[], None],
) -> tuple[TrainingViews, tuple[int, ...]]:
    """Watermark the cover's pictures of a random half of the views; also return the rows of these views, ascending.

    With an odd number of views, it is the smaller half. All else, including messages, is shared with `views`. `codec`
    and `watermark` must be on the same device; pictures stay on the CPU. Large pictures take seconds each; `after_each`
    of them is called, and may raise to stop.

    The paper mixes photos with and without the watermark "in a 50% ratio"; using both versions of every view would fit
    that description as well. Raises `UserError` for a single view, half of which is none.
    """
    count = len(views.cameras)
    if count < 2:
        raise UserError(
            "half of the training views are to be watermarked",
            found=f"{count} training view",
            expected="two or more",
            remedy="Give a capture of more photos, or set marked: false.",
        )
    chosen = np.random.default_rng(seed).permutation(count)[: count // 2]
    rows = tuple(sorted(int(row) for row in chosen))
    pictures = [*views.pictures[COVER]]
    for row in rows:
        marked = watermarked(pictures[row].to(watermark.device).float() / 255, codec, watermark)
        pictures[row] = marked.mul(255).round().to(torch.uint8).cpu()
        after_each()
    return replace(views, pictures={**views.pictures, COVER: pictures}), rows


@torch.no_grad()
def watermarked(
    picture: Float[Tensor, "H W 3"], codec: WatermarkCodec, watermark: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """E_w(I, W_cop), clamped to [0, 1]. Raises `ValueError` for odd sides."""
    return codec.encode(picture, watermark).clamp(0, 1)


@dataclass(frozen=True)
class FeatureRates:
    """Adam's learning rate of f_i, which decays to `final_share` of itself."""

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
    """A training that changes only f_i, or the spherical harmonics of methods without features.

    With learning rates of 0, Adam leaves positions, shapes and opacities unchanged to the last bit. A container's own
    networks come from `read_method`, which freezes them. No Gaussian is added or removed. Harmonics keep the ratio of
    3DGS's learning rates; the constant one gets the rate of f_i.
    """
    settings = TrainingSettings(
        iterations=iterations,
        extent=1.0,  # only scales the positions' learning rate
        seed=seed,
        attribute_rates={**dict.fromkeys(GEOMETRY, 0.0), **attribute_rates(method, rates.features)},
        network_rate=0.0,
        final_rate_share=rates.final_share,
        goes_on=True,
        density=None,
    )
    return Training(gaussians, method, views, terms, settings, fixed)


def refuse_unknown_attributes(gaussians: Gaussians, method: Method, stage: str) -> None:
    """Raise `UserError` if the Gaussians have attributes that the method, as given to `stage`, does not know.

    This happens for containers of 3DGS+SH if the secret, which names their messages, is not given.
    """
    unknown = gaussians.attributes.keys() - method.learning_rates.keys()
    if unknown:
        raise UserError(
            "the container has message attributes that cannot be read without the secret",
            found=", ".join(sorted(unknown)),
            expected="the secret as well, which says how many messages they belong to",
            remedy=f"give {stage} the input secret: hide.secret",
        )


def attribute_rates(method: Method, rate: float) -> dict[str, float]:
    """Scale the method's learning rates so that the largest equals `rate`."""
    fastest = max(method.learning_rates.values())
    return {name: rate * own / fastest for name, own in method.learning_rates.items()}
