"""3DGS+SH, the first of the paper's intuitive approaches (3.2): another set of spherical harmonics for each message.

Cover and messages share positions, shapes and opacities. Nothing is hidden: a message's harmonics are in the published
file, and removing them does not affect the cover. The paper uses this method as a baseline for fidelity.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

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


class HarmonicsForEach:
    """Harmonics of the cover, and of each message with attributes of their own.

    `sh_base [N,3]` and `sh_rest [N,K,3]` are the cover's, `message_sh_base [N,L,3]` and `message_sh_rest [N,L,K,3]`
    those of L messages.
    """

    name = "sh"

    def __init__(self, sh_degree: int, messages: Sequence[str] = ()):
        self.sh_degree = sh_degree
        self.messages = tuple(messages)
        self.settings: Mapping[str, int | float | str] = {"sh_degree": sh_degree}
        own = {SH_BASE: RATES[0], SH_REST: RATES[1]}
        self.learning_rates: Mapping[str, float] = own | (
            {f"message_{name}": rate for name, rate in own.items()} if self.messages else {}
        )
        self.networks: Mapping[str, torch.nn.Module] = {}

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Harmonics that show the points' colours in every picture and every direction."""
        base, rest = initial_harmonics(colors[COVER], self.sh_degree)
        attributes = {SH_BASE: base, SH_REST: rest}
        if self.messages:
            bases, rests = zip(
                *(initial_harmonics(colors[name], self.sh_degree) for name in self.messages), strict=True
            )
            attributes |= {"message_sh_base": torch.stack(bases, dim=1), "message_sh_rest": torch.stack(rests, dim=1)}
        return attributes

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """Harmonics up to `sh_degree`, for the cover and for every message."""
        base, rest = harmonics_shapes(self.sh_degree)
        shapes = {SH_BASE: base, SH_REST: rest}
        if self.messages:
            count = len(self.messages)
            shapes |= {"message_sh_base": (count, *base), "message_sh_rest": (count, *rest)}
        return shapes

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """Render the cover and every message over black, in a single pass."""
        degree = degree_at(self.sh_degree, progress)
        sets = [(gaussians[SH_BASE], gaussians[SH_REST])]
        if self.messages:
            bases, rests = gaussians["message_sh_base"].unbind(dim=1), gaussians["message_sh_rest"].unbind(dim=1)
            sets += zip(bases, rests, strict=True)
        colors = [seen_colors(gaussians, base.contiguous(), rest.contiguous(), camera, degree) for base, rest in sets]
        rendering = splat(gaussians, torch.cat(colors, dim=-1), camera)
        pictures = rendering.feature_map.split(3, dim=-1)
        rendering.pictures.update(zip((COVER, *self.messages), pictures, strict=True))
        return rendering

    def penalty(self, gaussians: Gaussians) -> None:
        """None, as in the paper."""


def build(settings: Mapping[str, object]) -> HarmonicsForEach:
    """Build the method from its settings; without `messages`, it shows the cover only."""
    return HarmonicsForEach(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError
