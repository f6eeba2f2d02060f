"""3DGS+Decoder, the paper's other intuitive approach (3.2): a decoder turns the rendered picture into the messages.

As in StegaNeRF, the Gaussians keep 3DGS's attributes, and small deviations in them must carry the message: Gaussians
and decoder are optimised jointly until the cover's pictures reveal it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.coupled import DECODERS
from stages.hiding.decoders import PRECISIONS, Decoder, decode
from stages.hiding.methods.plain import Plain
from stages.hiding.networks import MESSAGE_DECODER
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.timing.stopwatch import backward_of, part

SETTINGS = ("sh_degree", "layers", "decoder_width", "kernel_size", "precision")


class PlainWithDecoder(Plain):
    """3DGS with a message decoder D_m of 3·L channels that reads the unclamped pictures of the cover.

    So it is also evaluated (not after attacks on renders): a picture of 8 bits, clamped to [0, 1], may show less.
    The decoder starts from torch's random weights: initially, no part of the cover's picture belongs to a message.
    Raises `KeyError` for a precision that is not in `PRECISIONS`.
    """

    name = "decoder"

    def __init__(
        self,
        sh_degree: int,
        layers: int,
        decoder_width: int,
        precision: str,
        kernel_size: int = 3,
        messages: Sequence[str] = (),
    ):
        super().__init__(sh_degree)
        self.messages = tuple(messages)
        self.precision = PRECISIONS[precision]
        self.settings = {
            "sh_degree": sh_degree,
            "layers": layers,
            "decoder_width": decoder_width,
            "kernel_size": kernel_size,
            "precision": precision,
        }
        if self.messages:
            self.message_decoder = Decoder(3, 3 * len(self.messages), layers, decoder_width, kernel_size)
            self.message_decoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in its stub
            self.networks = {MESSAGE_DECODER: self.message_decoder}

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """Render the cover over black, and decode the messages from its picture if one is wanted."""
        rendering = super().render(gaussians, camera, progress)
        if self.messages and (wanted is None or set(wanted) & set(self.messages)):
            rendering.pictures.update(self.read_off(rendering.pictures[COVER]))
        return rendering

    def read_off(self, picture: Float[Tensor, "H W 3"]) -> dict[str, Float[Tensor, "H W 3"]]:
        """The messages, unclamped, that the decoder reads from a picture of the cover, which may have been altered."""
        with part(DECODERS):
            decoded = decode(self.message_decoder, picture, self.precision)
        backward_of(DECODERS, decoded)
        return dict(zip(self.messages, decoded.split(3, dim=-1), strict=True))


def build(settings: Mapping[str, object]) -> PlainWithDecoder:
    """Build the method from its settings, which lack `messages` if the secret is not available."""
    return PlainWithDecoder(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError
