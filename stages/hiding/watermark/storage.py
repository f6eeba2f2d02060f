"""Watermark codecs in the store: settings and weights, as numeric arrays."""

from __future__ import annotations

import torch

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.hiding.watermark.codec import WatermarkCodec
from stages.scene.attributes import mapping

KIND = "codec"
SIZES, WHOLE = ("blocks", "width"), "sees_whole_pictures"


def write_codec(writer: ArtifactWriter, codec: WatermarkCodec) -> None:
    """Write a codec. One trained on photos is public; one whose decoder was tuned must stay with the owner."""
    writer.attributes.update(settings=dict(codec.settings))
    for name, tensor in codec.state_dict().items():
        writer.write(name.replace(".", "/"), tensor.contiguous().cpu().numpy())


def read_codec(artifact: Artifact) -> WatermarkCodec:
    """Read a codec and freeze it. Raises `UserError` if its weights do not fit its settings."""
    settings = mapping(artifact, "settings")
    weights = {name.replace("/", "."): torch.from_numpy(artifact.read(name)) for name in artifact.names}
    try:
        with torch.random.fork_rng(devices=[]):
            blocks, width = (int(str(settings[name])) for name in SIZES)
            codec = WatermarkCodec(blocks, width, settings.get(WHOLE) is True)  # older codecs lack this setting
        codec.lost = torch.nn.Parameter(weights["lost"])
        codec.load_state_dict(weights)
    except (KeyError, ValueError, RuntimeError) as error:
        raise UserError(
            "the weights of a watermark codec do not fit its settings",
            where=str(artifact.path),
            found=str(error).splitlines()[0],
            expected=f"the settings {', '.join(SIZES)} and the weights that they lead to",
            remedy="the artifact was not made by this version; make it again",
        ) from error
    return codec.requires_grad_(False)
