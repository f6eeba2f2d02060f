"""What all methods with coupled features have in common: their settings, and a public and a secret decoder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, TypeVar

import torch

FEATURE_RANGE = (0.02, 0.98)
"""Initial features stay inside, where the sigmoid still has a gradient."""

FEATURE_RATE = 2.5e-3
"""Of Adam, as in the released code."""

DecoderType = TypeVar("DecoderType", bound=torch.nn.Module)


class CoupledFeatures(Generic[DecoderType]):
    """`raw_features [N,M]`, a scene decoder that is public, and a message decoder with 3·L channels that is not.

    Without messages (L = 0), or where the secret is not at hand, there is no message decoder. `make_decoder` makes one
    for so many pictures; weights come from torch's generator, the scene decoder's first.
    """

    def __init__(
        self,
        make_decoder: Callable[[int], DecoderType],
        feature_dim: int,
        layers: int,
        decoder_width: int,
        precision: str,
        messages: Sequence[str],
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
        self.scene_decoder = make_decoder(1)
        self.networks: dict[str, torch.nn.Module] = {"scene_decoder": self.scene_decoder}
        if self.messages:
            self.message_decoder = make_decoder(len(self.messages))
            self.networks["message_decoder"] = self.message_decoder
        for network in self.networks.values():
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's stub omits it
