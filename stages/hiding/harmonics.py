"""Colours from spherical harmonics, optimised and evaluated as in 3DGS; shared by all methods that have them."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from opencl.harmonics import colors_of_harmonics
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC, harmonics_count
from stages.timing.stopwatch import backward_of, part

SPHERICAL_HARMONICS = "spherical harmonics"

DEGREE_RAISED_EVERY = 1 / 30
"""3DGS raises the degree every 1,000 of its 30,000 iterations."""

RATES = (2.5e-3, 2.5e-3 / 20)
"""Adam's learning rates of the constant harmonic and of the others."""


def initial_harmonics(
    colors: Float[np.ndarray, "N 3"], sh_degree: int
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N K 3"]]:
    """The constant harmonic and the others for Gaussians that show these sRGB colours in every direction."""
    base = (torch.as_tensor(colors, dtype=torch.float32) - 0.5) / CONSTANT_HARMONIC
    return base, torch.zeros(len(base), harmonics_count(sh_degree) - 1, 3)


def harmonics_shapes(sh_degree: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The shapes of one Gaussian's constant harmonic and of its others: (3,) and (K, 3).

    Raises `ValueError` for a degree outside 0..3, and `TypeError` for one that is not an integer.
    """
    base, rest = initial_harmonics(np.zeros((0, 3)), sh_degree)
    return tuple(base.shape[1:]), tuple(rest.shape[1:])


def degree_at(sh_degree: int, progress: float) -> int:
    """The degree of harmonics in use after this share, in [0, 1], of the schedules."""
    return min(sh_degree, int(progress / DEGREE_RAISED_EVERY))


def seen_colors(
    gaussians: Gaussians, base: Float[Tensor, "N 3"], rest: Float[Tensor, "N K 3"], camera: Camera, degree: int
) -> Float[Tensor, "N 3"]:
    """The colour of every Gaussian as seen from the camera's centre, from the harmonics `base` and `rest`."""
    with part(SPHERICAL_HARMONICS):
        colors = colors_of_harmonics(base, rest, gaussians.means, camera.centre, degree)
    backward_of(SPHERICAL_HARMONICS, colors)
    return colors
