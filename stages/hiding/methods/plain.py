"""Unmodified 3DGS: colours from spherical harmonics, no message. The paper's upper bound on fidelity."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.harmonics import RATES, degree_at, harmonics_shapes, initial_harmonics, seen_colors
from stages.hiding.rendering import COVER, Rendering, splat
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.scene.spherical_harmonics import SH_BASE, SH_REST

SETTINGS = ("sh_degree",)


class Plain:
    """3DGS: `sh_base [N,3]` is the constant harmonic, `sh_rest [N,K,3]` the others, learnt at a 20 times lower rate."""

    name = "plain"

    def __init__(self, sh_degree: int):
        self.sh_degree = sh_degree
        self.messages: tuple[str, ...] = ()
        self.settings: Mapping[str, int | float | str] = {"sh_degree": sh_degree}
        self.learning_rates: Mapping[str, float] = {SH_BASE: RATES[0], SH_REST: RATES[1]}
        self.networks: Mapping[str, torch.nn.Module] = {}

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Harmonics that show the points' colours in every direction."""
        base, rest = initial_harmonics(colors[COVER], self.sh_degree)
        return {SH_BASE: base, SH_REST: rest}

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """Harmonics up to `sh_degree`."""
        base, rest = harmonics_shapes(self.sh_degree)
        return {SH_BASE: base, SH_REST: rest}

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """Render the cover over black."""
        colors = seen_colors(
            gaussians, gaussians[SH_BASE], gaussians[SH_REST], camera, degree_at(self.sh_degree, progress)
        )
        rendering = splat(gaussians, colors, camera)
        rendering.pictures[COVER] = rendering.feature_map
        return rendering

    def penalty(self, gaussians: Gaussians) -> None:
        """None, as in the paper."""


def build(settings: Mapping[str, object]) -> Plain:
    """Build 3DGS with harmonics up to `sh_degree`."""
    return Plain(int(str(settings["sh_degree"])))
