"""Which pictures are compared, and with which weight: Eq. 6, Eq. 7 and their sum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.rendering import COVER
from stages.imaging.ssim import ssim


@dataclass(frozen=True)
class PictureTerm:
    """How one picture of a rendering counts: `weight` in the sum, `ssim_weight` (γ or β) inside its own loss."""

    picture: str
    weight: float
    ssim_weight: float


def picture_loss(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], ssim_weight: float
) -> Float[Tensor, ""]:
    """(1 - γ) L1 + γ (1 - SSIM): Eq. 6 for the cover, Eq. 7 for a message. The picture is not clamped."""
    difference = torch.nn.functional.l1_loss(picture, truth)
    return (1 - ssim_weight) * difference + ssim_weight * (1 - ssim(picture, truth))


def total_loss(
    pictures: Mapping[str, Float[Tensor, "H W 3"]],
    truths: Mapping[str, Float[Tensor, "H W 3"]],
    terms: Sequence[PictureTerm],
) -> Float[Tensor, ""]:
    """Σ weight · loss over the terms: ℓ_total = ℓ_rgb + λ ℓ_mes. Raises `KeyError` for a picture that is not there."""
    losses = [
        term.weight * picture_loss(pictures[term.picture], truths[term.picture], term.ssim_weight) for term in terms
    ]
    return torch.stack(losses).sum()


def hiding_terms(
    messages: Sequence[str], lambda_message: float, ssim_weight_cover: float = 0.2, ssim_weight_message: float = 0.2
) -> tuple[PictureTerm, ...]:
    """The joint objective: the cover with weight 1, each of the L messages with λ.

    The paper leaves open whether λ is shared by L messages; a weight for each keeps what one message costs and gains
    the same whatever else is hidden.
    """
    cover = PictureTerm(COVER, 1.0, ssim_weight_cover)
    return (cover, *(PictureTerm(name, lambda_message, ssim_weight_message) for name in messages))
