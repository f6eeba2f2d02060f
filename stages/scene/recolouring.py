"""Linear changes of colour, which apply to spherical harmonics once for all directions.

Hue and saturation are those of CSS filters (Filter Effects Module, level 1), known from any browser. They preserve the
luminance of colours that stay within [0, 1].
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from stages.scene.spherical_harmonics import CONSTANT_HARMONIC

LUMINANCE = np.array([0.213, 0.715, 0.072])


def recolouring(
    hue: float, saturation: float, tint: tuple[float, float, float], strength: float
) -> Float64[np.ndarray, "3 3"]:
    """The matrix that rotates hues of sRGB colours by `hue` degrees, multiplies their saturation, and mixes in a tint.

    A fraction `strength` of each colour becomes the tint times the colour's luminance: 1 leaves nothing but its shades.
    `hue` 0, `saturation` 1 and `strength` 0 change nothing.
    """
    tinted = (1 - strength) * np.eye(3) + strength * np.outer(tint, LUMINANCE)
    return tinted @ _saturated(saturation) @ _turned_hue(hue)


def recoloured(
    base: Float[Tensor, "N 3"], rest: Float[Tensor, "N K 3"], matrix: Float64[np.ndarray, "3 3"]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N K 3"]]:
    """3DGS's harmonics after the matrix is applied to the colour of every direction.

    A colour is 0.5 plus the harmonics, so the matrix applies to that half, too. Exact where colours are not clamped.
    """
    turned = torch.as_tensor(matrix, dtype=torch.float64)
    half = torch.full((3,), 0.5, dtype=torch.float64)
    moved = base.double() @ turned.T + (turned @ half - half) / CONSTANT_HARMONIC
    return moved.to(base.dtype), (rest.double() @ turned.T).to(rest.dtype)


def _saturated(saturation: float) -> Float64[np.ndarray, "3 3"]:
    return saturation * np.eye(3) + (1 - saturation) * np.outer(np.ones(3), LUMINANCE)


def _turned_hue(degrees: float) -> Float64[np.ndarray, "3 3"]:
    """The standard's matrix: grey stays, and the rest of a colour rotates about it at constant luminance."""
    grey = np.outer(np.ones(3), LUMINANCE)
    across = np.array([[-0.213, -0.715, 0.928], [0.143, 0.140, -0.283], [-0.787, 0.715, 0.072]])
    angle = np.radians(degrees)
    return grey + np.cos(angle) * (np.eye(3) - grey) + np.sin(angle) * across
