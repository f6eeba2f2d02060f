"""3DGS as it is: colour from spherical harmonics, no message. The upper bound that the paper compares against."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from opencl.harmonics import colors_of_harmonics
from stages.hiding.rendering import COVER, Rendering, splat
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.scene.spherical_harmonics import BASE, harmonics_count
from stages.timing.stopwatch import backward_of, part

SPHERICAL_HARMONICS = "spherical harmonics"

DEGREE_RAISED_EVERY = 1 / 30
"""3DGS raises the degree every 1,000 of its 30,000 iterations."""


class Plain:
    """3DGS: `sh_base [N,3]` is the constant harmonic, `sh_rest [N,K-1,3]` the others, learnt 20 times slower."""

    name = "plain"

    def __init__(self, sh_degree: int):
        self.sh_degree = sh_degree
        self.settings: Mapping[str, int | float | str] = {"sh_degree": sh_degree}
        self.learning_rates: Mapping[str, float] = {"sh_base": 2.5e-3, "sh_rest": 2.5e-3 / 20}
        self.networks: Mapping[str, torch.nn.Module] = {}

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """The points' colours, the same from everywhere."""
        base = (torch.as_tensor(colors[COVER], dtype=torch.float32) - 0.5) / BASE
        return {"sh_base": base, "sh_rest": torch.zeros(len(base), harmonics_count(self.sh_degree) - 1, 3)}

    def render(self, gaussians: Gaussians, camera: Camera, progress: float = 1.0) -> Rendering:
        """The cover's picture over black."""
        degree = min(self.sh_degree, int(progress / DEGREE_RAISED_EVERY))
        with part(SPHERICAL_HARMONICS):
            colors = colors_of_harmonics(
                gaussians["sh_base"], gaussians["sh_rest"], gaussians.means, camera.centre, degree
            )
        backward_of(SPHERICAL_HARMONICS, colors)
        rendering = splat(gaussians, colors, camera)
        rendering.pictures[COVER] = rendering.feature_map
        return rendering


def build(settings: Mapping[str, object]) -> Plain:
    """3DGS with harmonics up to `sh_degree`."""
    return Plain(int(str(settings["sh_degree"])))
