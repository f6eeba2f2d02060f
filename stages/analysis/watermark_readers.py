"""Readers of watermarks in pictures: the paper's decoder, and the owner of a container with grain."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.watermark_trials import Shows
from stages.hiding.watermark.codec import WatermarkCodec
from stages.hiding.watermark.reading import GrainReader
from stages.imaging.pictures import Picture
from stages.training.decoder_tuning import decoded, resized_to


def shown_by_decoder(codec: WatermarkCodec) -> Shows:
    """The paper's reader, D_w. It runs on the codec's device; its output is on the CPU."""

    @torch.no_grad()
    def shows(picture: Picture) -> Float[Tensor, "H W 3"]:
        return decoded(codec, picture).cpu()

    return shows


def shown_by_grain(reader: GrainReader, watermark: Picture) -> Shows:
    """Our reader: it shows the watermark multiplied by the owner's certainty that the picture has the grain."""
    return lambda picture: reader.certainty(picture) * resized_to(picture, watermark)
