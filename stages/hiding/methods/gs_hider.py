"""GS-Hider: a coupled feature a Gaussian, blended into one feature map, read by two decoders (section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.decoders import Decoder, decode
from stages.hiding.mixture import orthonormal_rows
from stages.hiding.rendering import COVER, Rendering, splat
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

FEATURE_RANGE = (0.02, 0.98)
"""Initial features stay inside, where the sigmoid still has a gradient."""

FEATURE_RATE = 2.5e-3
"""Of Adam, as in the released code."""


class GSHider:
    """`raw_features [N,M]`, a scene decoder that is public, and a message decoder with 3·L channels that is not.

    Without messages (L = 0), or where the secret is not at hand, only the cover is decoded.
    """

    name = "gs_hider"

    def __init__(
        self,
        feature_dim: int,
        layers: int,
        decoder_width: int,
        precision: str,
        messages: Sequence[str] = (),
    ):
        self.feature_dim = feature_dim
        self.messages = tuple(messages)
        self.precision = getattr(torch, precision)
        self.settings: Mapping[str, int | float | str] = {
            "feature_dim": feature_dim,
            "layers": layers,
            "decoder_width": decoder_width,
            "precision": precision,
        }
        self.learning_rates: Mapping[str, float] = {"raw_features": FEATURE_RATE}
        self.scene_decoder = Decoder(feature_dim, 3, layers, decoder_width)
        self.networks: dict[str, torch.nn.Module] = {"scene_decoder": self.scene_decoder}
        if self.messages:
            self.message_decoder = Decoder(feature_dim, 3 * len(self.messages), layers, decoder_width)
            self.networks["message_decoder"] = self.message_decoder
        for network in self.networks.values():
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's stub omits it

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Features that the decoders show as the points' colours, in the cover and in every message.

        The released code starts from zeros and random decoders, which needs tens of thousands of iterations. Here every
        decoder starts as a linear map of its own three channels out of a random orthonormal mixture of all M: each
        channel of the feature map carries something of the cover and of every message, and which mixture is a
        message's follows from `generator`, that is, from the key.
        """
        mixture = orthonormal_rows(3 + 3 * len(self.messages), self.feature_dim, generator)
        self.scene_decoder.pass_through(mixture[:3])
        if self.messages:
            self.message_decoder.pass_through(mixture[3:])
        shown = torch.as_tensor(np.concatenate([colors[name] for name in (COVER, *self.messages)], axis=1)).float()
        features = 0.5 + (shown - 0.5) @ mixture
        return {"raw_features": features.clamp(*FEATURE_RANGE).logit()}

    def render(self, gaussians: Gaussians, camera: Camera, progress: float = 1.0) -> Rendering:
        """F_coup (Eq. 4) and what the decoders make of it (Eq. 5)."""
        rendering = splat(gaussians, gaussians["raw_features"].sigmoid(), camera)
        rendering.pictures[COVER] = decode(self.scene_decoder, rendering.feature_map, self.precision)
        if self.messages:
            decoded = decode(self.message_decoder, rendering.feature_map, self.precision)
            rendering.pictures.update(zip(self.messages, decoded.split(3, dim=-1), strict=True))
        return rendering


def build(settings: Mapping[str, object]) -> GSHider:
    """GS-Hider from its settings; `messages` may be absent where the secret is not at hand."""
    return GSHider(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError by its name
