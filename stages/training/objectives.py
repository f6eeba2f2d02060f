"""Which pictures are compared, and with which weights: Eq. 6, Eq. 7 and their sum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.rendering import COVER
from stages.imaging.ssim import ssim
from stages.scene.cameras import Camera


@dataclass(frozen=True)
class PictureTerm:
    """One picture's part of the objective: `weight` in the sum, `ssim_weight` (γ or β) inside its own loss."""

    picture: str
    weight: float
    ssim_weight: float


@dataclass(frozen=True)
class FixedView:
    """A picture that one camera must see in every iteration, whichever view is drawn: a hidden image (section 4.6)."""

    term: PictureTerm
    camera: Camera
    truth: UInt8[Tensor, "H W 3"]


@dataclass(frozen=True)
class Compared:
    """A rendered picture, unclamped, and its ground truth in [0, 1]."""

    term: PictureTerm
    picture: Float[Tensor, "H W 3"]
    truth: Float[Tensor, "H W 3"]

    def squared_error(self) -> float:
        """The mean squared error of the picture, clamped to [0, 1]."""
        return float((self.picture.clamp(0, 1) - self.truth).square().mean())


def picture_loss(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], ssim_weight: float
) -> Float[Tensor, ""]:
    """(1 - γ) L1 + γ (1 - SSIM): Eq. 6 for the cover, Eq. 7 for a message. The picture is not clamped."""
    difference = torch.nn.functional.l1_loss(picture, truth)
    return (1 - ssim_weight) * difference + ssim_weight * (1 - ssim(picture, truth))


def total_loss(compared: Sequence[Compared]) -> Float[Tensor, ""]:
    """Σ weight · loss over all compared pictures, at least one: ℓ_total = ℓ_rgb + λ ℓ_mes."""
    losses = [each.term.weight * picture_loss(each.picture, each.truth, each.term.ssim_weight) for each in compared]
    return torch.stack(losses).sum()


def hiding_terms(
    messages: Sequence[str], lambda_message: float, ssim_weight_cover: float = 0.2, ssim_weight_message: float = 0.2
) -> tuple[PictureTerm, ...]:
    """The joint objective: the cover with weight 1, each of the L messages with λ.

    The paper does not say whether L messages share λ. With λ for each, what a message costs and gains does not depend
    on what else is hidden.
    """
    hidden = (PictureTerm(name, lambda_message, ssim_weight_message) for name in messages)
    return (cover_term(ssim_weight_cover), *hidden)


def cover_term(ssim_weight: float) -> PictureTerm:
    """The cover's term, ℓ_rgb, with weight 1."""
    return PictureTerm(COVER, 1.0, ssim_weight)
