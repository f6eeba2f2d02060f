"""GS-Hider: one coupled feature per Gaussian, blended into a feature map that two decoders read (section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.coupled import COUPLED_SETTINGS, FEATURE_RANGE, FEATURES, CoupledFeatures
from stages.hiding.decoders import Decoder, decode
from stages.hiding.mixture import orthonormal_rows
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Camera

SETTINGS = COUPLED_SETTINGS


class GSHider(CoupledFeatures[Decoder]):
    """The paper's method: both decoders read the feature map as it is."""

    name = "gs_hider"

    def make_decoder(self, pictures: int, layers: int, width: int, kernel_size: int) -> Decoder:
        """Make a decoder for this many pictures; the paper's has five convolutions."""
        return Decoder(self.feature_dim, 3 * pictures, layers, width, kernel_size)

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Features that the decoders show as the points' colours, in the cover and in every message.

        The released code starts from zeros and random decoders, and needs tens of thousands of iterations. Here, every
        decoder starts as a linear map that reads its own three channels from a random orthonormal mixture of all M:
        each channel of the feature map carries a part of the cover and of every message. `generator`, and so the key,
        determines which mixture belongs to a message.
        """
        mixture = orthonormal_rows(3 + 3 * len(self.messages), self.feature_dim, generator)
        self.scene_decoder.pass_through(mixture[:3])
        if self.messages:
            self.message_decoder.pass_through(mixture[3:])
        shown = torch.as_tensor(np.concatenate([colors[name] for name in (COVER, *self.messages)], axis=1)).float()
        features = 0.5 + (shown - 0.5) @ mixture
        return {FEATURES: features.clamp(*FEATURE_RANGE).logit()}

    def decoded(
        self, decoders: Sequence[Decoder], rendering: Rendering, camera: Camera
    ) -> list[Float[Tensor, "H W _"]]:
        """Run the feature map through each decoder (Eq. 5)."""
        return [decode(decoder, rendering.feature_map, self.precision) for decoder in decoders]


def build(settings: Mapping[str, object]) -> GSHider:
    """Build GS-Hider from its settings, which lack `messages` if the secret is not available."""
    return GSHider(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError by its name
