"""How faithful a rendered picture is: every figure of the paper's tables for one view."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from jaxtyping import Bool, Float
from torch import Tensor

from stages.imaging.psnr import psnr
from stages.imaging.ssim import ssim, ssim_map

Perceptual = Mapping[str, Callable[[Tensor, Tensor], float]]
"""LPIPS by quantity name, for the networks whose weights are at hand."""

COVERED = 0.5
"""A pixel counts as covered where the message fills at least half of it."""


def picture_figures(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], perceptual: Perceptual
) -> dict[str, float]:
    """PSNR, SSIM and LPIPS of a whole picture; it is clamped to [0, 1] first, as a viewer would.

    It is not rounded to 8 bits, as pictures are that the script of 3DGS compares: that costs 0.2 dB at 45 dB, and 0.02
    at 35.
    """
    picture = picture.clamp(0, 1)
    figures = {"psnr": psnr(picture, truth), "ssim": float(ssim(picture, truth))}
    return figures | {name: measure(picture, truth) for name, measure in perceptual.items()}


def covered_figures(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W"]
) -> dict[str, float]:
    """PSNR and SSIM over the covered pixels, and the PSNR there of the best picture of one colour: the floor.

    All are NaN where the message covers nothing, the floor also where what it shows is of one colour.
    """
    return {
        **covered_psnrs(picture, truth, coverage),
        "ssim_covered": _mean_over(ssim_map(picture.clamp(0, 1), truth), coverage >= COVERED),
    }


def covered_psnrs(
    picture: Float[Tensor, "H W 3"], truth: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W"]
) -> dict[str, float]:
    """Those of `covered_figures` alone: a map of similarities takes as long as a picture's rendering."""
    mask = coverage >= COVERED
    return {
        "psnr_covered": psnr(picture.clamp(0, 1), truth, mask),
        "psnr_constant": one_colour_psnr(truth, mask),
    }


def _mean_over(values: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> float:
    return float(values[mask].mean())


def one_colour_psnr(truth: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"] | None = None) -> float:
    """PSNR of the best picture of one colour, over the pixels of the mask: what shows nothing is no better.

    NaN where the truth itself is of one colour there, as a view is in which nothing of a message is seen: its floor
    would be infinite, and with it the mean over all views. The constant with the least squared error is the mean.
    """
    colors = truth.reshape(-1, 3) if mask is None else truth[mask]
    if not shows_something(colors):
        return math.nan
    return psnr(colors.mean(dim=0).expand_as(truth), truth, mask)


def where_seen(figures: Mapping[str, float], truth: Float[Tensor, "H W 3"]) -> dict[str, float]:
    """A message's figures in one view, all NaN where the view shows nothing of it.

    Black is all of it there: a black render would be perfect, and the mean over all views infinite.
    """
    seen = shows_something(truth)
    return {quantity: value if seen else math.nan for quantity, value in figures.items()}


def shows_something(colors: Float[Tensor, "*pixels 3"]) -> bool:
    """Whether there are two colours among these pixels."""
    colors = colors.reshape(-1, 3)
    return len(colors) > 0 and not bool((colors == colors[0]).all())
