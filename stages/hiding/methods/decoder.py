"""3DGS+Decoder: a decoder turns the rendered picture into the messages, the paper's other intuitive approach (3.2).

As in StegaNeRF the splats stay 3DGS's own, and what differs from them must carry the message: Gaussians and the
decoder are trained together until the pictures of the cover show it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.coupled import DECODERS
from stages.hiding.decoders import PRECISIONS, Decoder, decode
from stages.hiding.methods.plain import Plain
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.timing.stopwatch import backward_of, part

SETTINGS = ("sh_degree", "layers", "decoder_width", "precision")


class PlainWithDecoder(Plain):
    """3DGS, and a message decoder D_m of 3·L channels on its unclamped pictures.

    The decoder starts from torch's random weights: nothing of a picture of the cover is a message's from the start.
    Raises `KeyError` for a precision that is none of `PRECISIONS`.
    """

    name = "decoder"

    def __init__(self, sh_degree: int, layers: int, decoder_width: int, precision: str, messages: Sequence[str] = ()):
        super().__init__(sh_degree)
        self.messages = tuple(messages)
        self.precision = PRECISIONS[precision]
        self.settings = {
            "sh_degree": sh_degree,
            "layers": layers,
            "decoder_width": decoder_width,
            "precision": precision,
        }
        if self.messages:
            self.message_decoder = Decoder(3, 3 * len(self.messages), layers, decoder_width)
            self.message_decoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in its stub
            self.networks = {"message_decoder": self.message_decoder}

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """The cover's picture over black, and what the decoder reads in it if that is wanted."""
        rendering = super().render(gaussians, camera, progress)
        if self.messages and (wanted is None or set(wanted) & set(self.messages)):
            rendering.pictures.update(self.read_off(rendering.pictures[COVER]))
        return rendering

    def read_off(self, picture: Float[Tensor, "H W 3"]) -> dict[str, Float[Tensor, "H W 3"]]:
        """The messages that the decoder reads in a picture of the cover, whatever befell it; unclamped."""
        with part(DECODERS):
            decoded = decode(self.message_decoder, picture, self.precision)
        backward_of(DECODERS, decoded)
        return dict(zip(self.messages, decoded.split(3, dim=-1), strict=True))


def build(settings: Mapping[str, object]) -> PlainWithDecoder:
    """The method from its settings; `messages` may be absent where the secret is not at hand."""
    return PlainWithDecoder(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError
