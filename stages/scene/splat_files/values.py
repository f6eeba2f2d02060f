"""The common result of all formats: 3DGS's stored values, checked whoever wrote the file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from stages.scene.garbage import refuse_garbage
from stages.scene.gaussians import Gaussians
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC

LARGEST_LOGIT = 30.0
"""Opacity logits are clipped to ± this: sigmoids 1 and 9e-14. Programs with byte opacities write ±infinity."""

HARMONICS_OF_DEGREE = {0: 0, 9: 1, 24: 2, 45: 3}
"""Degree of the spherical harmonics, by the number of coefficients beyond the constant ones: 3 ((degree + 1)² - 1)."""


@dataclass(frozen=True)
class SplatValues:
    """N Gaussians as 3DGS stores them; K = (degree + 1)², and quaternions are w x y z of any length."""

    means: Float[np.ndarray, "N 3"]
    quats: Float[np.ndarray, "N 4"]
    log_scales: Float[np.ndarray, "N 3"]
    logit_opacities: Float[np.ndarray, " N"]
    sh_base: Float[np.ndarray, "N 3"]
    sh_rest: Float[np.ndarray, "N rest 3"]


def gaussians_of(path: Path, values: SplatValues) -> Gaussians:
    """The values as Gaussians of the method `plain`, in float32, with opacity logits clipped to ±`LARGEST_LOGIT`.

    Raises `UserError` as `refuse_garbage` does.
    """
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which is refused
        arrays = {name: np.array(array, np.float32, order="C") for name, array in vars(values).items()}
    arrays["logit_opacities"] = arrays["logit_opacities"].clip(-LARGEST_LOGIT, LARGEST_LOGIT)  # NaN stays
    refuse_garbage(path, arrays)
    return Gaussians({name: torch.from_numpy(array) for name, array in arrays.items()})


def base_of_colors(colors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """The constant harmonics of colours that are the same in all directions."""
    return (colors - 0.5) / CONSTANT_HARMONIC


def logits_of_bytes(opacities: UInt8[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Logits of opacities in 255ths; 0 and 255 count as a quarter of a step from the end."""
    shares = (opacities / 255).clip(0.25 / 255, 1 - 0.25 / 255)
    return np.log(shares / (1 - shares))
