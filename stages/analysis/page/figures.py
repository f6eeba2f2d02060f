"""Names, definitions and formatting of the figures on a page."""

from __future__ import annotations

import math
from collections.abc import Mapping

from stages.imaging.quantities import QUANTITIES

MISSING = "–"

WORDING: Mapping[str, tuple[str, str]] = {
    "psnr": (
        "PSNR",
        "-10 log10 of the mean squared error over the whole picture, with colours clamped to [0, 1].",
    ),
    "ssim": (
        "SSIM",
        "Structural similarity: local means, contrasts and correlation in an 11 x 11 window of sigma 1.5.",
    ),
    "lpips_vgg": (
        "LPIPS",
        "Learned perceptual distance, version 0.1, between features of VGG16, with colours from -1 to 1 as LPIPS is "
        "defined. The script of 3DGS passes colours from 0 to 1, which raises or lowers it by up to a tenth.",
    ),
    "lpips_alex": ("LPIPS (AlexNet)", "Learned perceptual distance, version 0.1, between features of AlexNet."),
    "psnr_covered": ("PSNR, covered", "PSNR over only the pixels that the message fills."),
    "ssim_covered": ("SSIM, covered", "SSIM averaged over only the pixels that the message fills."),
    "psnr_constant": (
        "One colour",
        "PSNR of the best single-colour picture over the same covered pixels: the floor.",
    ),
    "coverage": ("Coverage", "How much of the picture the message fills, from 0 to 1."),
    "legal": ("Legal", "1 where the message fills enough of the picture to be scored, otherwise 0."),
    "hides_image": ("Hides the image", "1 for the view that hides the image."),
    "container_bytes": ("Size", "Everything that is published, uncompressed."),
    "total_bytes": ("Total size", "Everything that is published plus the secret decoder, uncompressed."),
    "gaussians": ("Gaussians", "How many Gaussians the scene has."),
    "seconds_per_frame": ("Time per frame", "Wall-clock time to render one picture, decoding included."),
    "seconds_per_feature_map": (
        "Time per feature map",
        "Wall-clock time to blend one feature map, before it is decoded.",
    ),
    "residual_correlation": (
        "Residual and message",
        "Absolute correlation of the cover's error with the message in that view.",
    ),
    "residual_correlation_others": (
        "Residual and others",
        "The same with the message in the other test views: the level of chance.",
    ),
    "loss": ("Loss", "The training objective, averaged since the previous point of the curve."),
}
"""The name and the definition of every quantity."""


def label(quantity: str) -> str:
    """The heading of a quantity, with the unit that ``write_figure`` uses for it."""
    shown_unit = {"bytes": "MB", "s": "ms"}.get(QUANTITIES[quantity].unit, QUANTITIES[quantity].unit)
    name = WORDING[quantity][0]
    return f"{name} ({shown_unit})" if shown_unit else name


def write_figure(quantity: str, value: float) -> str:
    """A value with its meaningful digits: decibels to 0.01, sizes in MB, times in ms, other figures to 0.001.

    >>> write_figure("psnr", 27.1249), write_figure("container_bytes", 2_345_678), write_figure("ssim", math.nan)
    ('27.12', '2.35', '–')
    >>> write_figure("psnr", -4e-8)
    '0.00'
    """
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    unit = QUANTITIES[quantity].unit
    if unit == "bytes":
        return f"{value / 1e6:.2f}"
    if unit == "s":
        return f"{value * 1e3:.1f}"
    if quantity == "gaussians":
        return f"{round(value):,}"
    return f"{value:z.2f}" if unit == "dB" else f"{value:z.3f}"  # z: no minus sign on a rounded zero


def write_seconds(seconds: float) -> str:
    """A duration in seconds, minutes and seconds, or hours and minutes.

    >>> write_seconds(0.031), write_seconds(12.34), write_seconds(3725)
    ('0.03 s', '12.3 s', '1 h 2 min')
    """
    if seconds < 59.95:
        return f"{seconds:.2f} s" if seconds < 1 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
