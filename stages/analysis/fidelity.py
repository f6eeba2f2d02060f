"""Fidelity of a rendered picture: the metrics of the paper's tables for one view."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from jaxtyping import Bool, Float
from torch import Tensor

from stages.imaging.psnr import psnr
from stages.imaging.ssim import ssim, ssim_map

Perceptual = Mapping[str, Callable[[Tensor, Tensor], float]]
"""LPIPS functions by quantity name, for the networks whose weights are installed."""

COVERED = 0.5
"""A pixel counts as covered if the message fills at least half of it."""


def picture_figures(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], perceptual: Perceptual
) -> dict[str, float]:
    """PSNR, SSIM and LPIPS of a whole picture, which is first clamped to [0, 1] as by a viewer.

    It is not rounded to 8 bits, unlike the pictures that the script of 3DGS compares. Rounding costs 0.2 dB at 45 dB,
    and 0.02 dB at 35 dB.
    """
    picture = picture.clamp(0, 1)
    figures = {"psnr": psnr(picture, truth), "ssim": float(ssim(picture, truth))}
    return figures | {name: measure(picture, truth) for name, measure in perceptual.items()}


def covered_figures(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W"]
) -> dict[str, float]:
    """PSNR and SSIM over the covered pixels, and as a floor the PSNR of the best single-colour picture there.

    All are NaN if the message covers nothing; the floor also if the covered pixels of the truth have a single colour.
    """
    return {
        **covered_psnrs(picture, truth, coverage),
        "ssim_covered": _mean_over(ssim_map(picture.clamp(0, 1), truth), coverage >= COVERED),
    }


def covered_psnrs(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W"]
) -> dict[str, float]:
    """The PSNRs of `covered_figures`, without the SSIM: computing its map takes as long as rendering a picture."""
    mask = coverage >= COVERED
    return {
        "psnr_covered": psnr(picture.clamp(0, 1), truth, mask),
        "psnr_constant": one_colour_psnr(truth, mask),
    }


def _mean_over(values: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> float:
    return float(values[mask].mean())


def one_colour_psnr(truth: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> float:
    """PSNR of the best single-colour picture over the pixels of the mask, a floor for pictures that show nothing.

    That colour is the mean, which has the least squared error. NaN if the truth itself has a single colour there, as in
    a view that shows nothing of a message: the floor, and the mean over all views, would be infinite.
    """
    colors = truth.reshape(-1, 3) if mask is None else truth[mask]
    if not shows_something(colors):
        return math.nan
    return psnr(colors.mean(dim=0).expand_as(truth), truth, mask)


def where_seen(figures: Mapping[str, float], truth: Float[Tensor, "H W 3"]) -> dict[str, float]:
    """A message's figures in one view, all NaN if the view shows nothing of it.

    The truth of such a view is plain black: a black render would have an infinite PSNR, and so would the mean over
    all views.
    """
    seen = shows_something(truth)
    return {quantity: value if seen else math.nan for quantity, value in figures.items()}


def shows_something(colors: Float[Tensor, "*pixels 3"]) -> bool:
    """Whether these pixels have at least two different colours; False if there are no pixels."""
    colors = colors.reshape(-1, 3)
    return len(colors) > 0 and not bool((colors == colors[0]).all())
