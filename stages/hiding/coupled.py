"""The common part of all methods with coupled features: settings, a public and a secret decoder, and rendering."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.decoders import PRECISIONS
from stages.hiding.networks import MESSAGE_DECODER, SCENE_DECODER
from stages.hiding.rendering import ACTIVATIONS, COVER, Rendering, splat
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.timing.stopwatch import backward_of, part

DECODERS = "decoders"

FEATURE_RANGE = (0.02, 0.98)
"""Initial activated features stay within this range, where the sigmoid still has a gradient."""

FEATURE_RATE = 2.5e-3
"""Adam's learning rate of features, as in the released code, where no other is given: hiding has `feature_rate`."""

FEATURES = "raw_features"
"""The attribute that all these methods add: f_i before its activation. Like the released code, we activate it with a
sigmoid; the paper blends f_i as it is (Eq. 4)."""

COUPLED_SETTINGS = ("feature_dim", "layers", "decoder_width", "kernel_size", "precision")

DecoderType = TypeVar("DecoderType", bound=torch.nn.Module)


class CoupledFeatures(ABC, Generic[DecoderType]):
    """Features `raw_features [N,M]`, a public scene decoder, and a secret message decoder with 3·L channels.

    Without messages (L = 0), or without the secret, there is no message decoder. Initial weights are drawn from torch's
    global generator, those of the scene decoder first. Raises `KeyError` for a precision that is not in `PRECISIONS`.

    A subclass sets what its `make_decoder` reads before `super().__init__`, which calls it, and adds settings of its
    own to `settings` after `super().__init__`, which sets them.
    """

    def __init__(
        self,
        feature_dim: int,
        layers: int,
        decoder_width: int,
        precision: str,
        messages: Sequence[str] = (),
        kernel_size: int = 3,
    ):
        self.feature_dim = feature_dim
        self.messages = tuple(messages)
        self.precision = PRECISIONS[precision]
        self.settings: Mapping[str, int | float | str] = {
            "feature_dim": feature_dim,
            "layers": layers,
            "decoder_width": decoder_width,
            "kernel_size": kernel_size,
            "precision": precision,
        }
        self.learning_rates: Mapping[str, float] = {FEATURES: FEATURE_RATE}
        self.scene_decoder = self.make_decoder(1, layers, decoder_width, kernel_size)
        self.decoders = [self.scene_decoder]
        self.networks: dict[str, torch.nn.Module] = {SCENE_DECODER: self.scene_decoder}
        if self.messages:
            self.message_decoder = self.make_decoder(len(self.messages), layers, decoder_width, kernel_size)
            self.decoders.append(self.message_decoder)
            self.networks[MESSAGE_DECODER] = self.message_decoder
        for network in self.networks.values():
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's stub omits it

    @abstractmethod
    def make_decoder(self, pictures: int, layers: int, width: int, kernel_size: int) -> DecoderType:
        """Make a decoder for this many pictures."""

    @abstractmethod
    def decoded(
        self, decoders: Sequence[DecoderType], rendering: Rendering, camera: Camera
    ) -> list[Float[Tensor, "H W _"]]:
        """The outputs of `decoders` for a rendered feature map, with three channels for each picture of a decoder."""

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """One feature of M values."""
        return {FEATURES: (self.feature_dim,)}

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """Render F_coup (Eq. 4) and decode it (Eq. 5). A decoder runs only if one of its pictures is wanted."""
        features = gaussians[FEATURES].sigmoid()
        backward_of(ACTIVATIONS, features)
        rendering = splat(gaussians, features, camera)
        shown = self._shown(wanted)
        with part(DECODERS):
            decoded = self.decoded([decoder for decoder, _ in shown], rendering, camera)
        backward_of(DECODERS, *decoded)
        for channels, (_, names) in zip(decoded, shown, strict=True):
            rendering.pictures.update(zip(names, channels.split(3, dim=-1), strict=True))
        return rendering

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """None, as in the paper."""
        return None

    def _shown(self, wanted: Collection[str] | None) -> list[tuple[DecoderType, tuple[str, ...]]]:
        """Each decoder with at least one wanted picture, and the names of all pictures that it shows."""
        pairs = zip(self.decoders, ((COVER,), self.messages), strict=False)
        return [(decoder, names) for decoder, names in pairs if wanted is None or set(names) & set(wanted)]
