"""`train_codec`: train a watermark encoder and decoder on photos (E_w and D_w of the paper's appendix A)."""

from __future__ import annotations

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.codec_quality import quality
from stages.analysis.measurements import write_measurements
from stages.hiding.watermark.codec import new_codec
from stages.hiding.watermark.storage import write_codec
from stages.imaging.image import read_image
from stages.imaging.metric_table import write_rows
from stages.imaging.photo_digests import HELD_OUT, SAMPLES
from stages.imaging.shipped_photos import HOW_TO_INSTALL, ShippedPhotos, read_photo
from stages.training.codec import CodecSettings, CodecTraining
from stages.training.codec_photos import parted, read_photos
from stages.training.network import train_network
from stages.training.threads import Threads


class TrainCodecParameters(Parameters):
    """Size and training of the network.

    Shipped photos are used only if they are installed; once they are, a codec trained without them is trained again.
    """

    blocks: int = Field(4, ge=1, description="Number of coupling blocks in the invertible network.")
    width: int = Field(32, ge=1, description="Channels between the network's convolutions.")
    iterations: int = Field(3000, ge=1, description="Training steps.")
    batch: int = Field(4, ge=1, description="Photo crops per step.")
    window: int = Field(64, ge=8, multiple_of=2, description="Side of these square crops, in pixels.")
    fidelity_weight: float = Field(
        2.0, ge=0, description="Weight of the watermarked picture's squared error, relative to that of the watermark."
    )
    shipped_photos: ShippedPhotos = Field(
        tuple(SAMPLES),
        description="File names of photos shipped with Python packages, used in addition to those of the captures.",
    )
    seed: int = Field(0, ge=0, description="Random seed for the initial weights and all sampling.")
    threads: Threads = 1


@stage(
    inputs={
        "photos": Input("capture", many=True, optional=True),
        "watermarks": Input("image", many=True, optional=True),
    },
    outputs={"codec": Output("codec"), "curves": Output("metrics"), "scores": Output("measurements")},
    version=1,
)
def train_codec(context: Context, parameters: TrainCodecParameters) -> None:
    """Train a codec to hide windows of photos, and the given watermarks, in windows of photos; score it on others.

    Every eighth photo of each capture is held out and, of the shipped photos, `HELD_OUT`; only these show things that
    no training photo shows. Raises `UserError` without photos to train on.
    """
    torch.set_num_threads(parameters.threads)
    captures = [parted(read_photos(artifact)) for artifact in context.input_many("photos")]
    shipped = {name: read_photo(name) for name in parameters.shipped_photos}
    if not shipped:
        context.log(f"no shipped photos are installed: the codec learns from captures only. {HOW_TO_INSTALL}")
    trained_on = [photo for name, photo in shipped.items() if name not in HELD_OUT]
    trained_on += [photo for learnt, _ in captures for photo in learnt]
    if not trained_on:
        raise UserError(
            "there are no photos to train on",
            found="only a capture of one photo, which is held out" if captures else "no capture and no shipped photos",
            expected="a capture of at least two photos, or shipped photos other than those held out",
            remedy=HOW_TO_INSTALL,
        )
    watermarks = [picture for _, picture in map(read_image, context.input_many("watermarks"))]
    codec = new_codec(parameters.blocks, parameters.width, parameters.seed).to(working_device())
    settings = CodecSettings(
        parameters.iterations, parameters.seed, parameters.batch, parameters.window, parameters.fidelity_weight
    )
    curves = train_network(context, CodecTraining(codec, trained_on, watermarks, settings))
    write_codec(context.output("codec"), codec)
    write_rows(context.output("curves"), curves)
    held_out = {
        "photos of other things": [shipped[name] for name in HELD_OUT if name in shipped],
        "other photos of the captures": [photo for _, others in captures for photo in others],
    }
    write_measurements(context.output("scores"), quality(codec, held_out, watermarks, parameters.seed))
    context.record(
        device=describe_drawing(working_device()),
        photos=len(trained_on),
        parameters=sum(weight.numel() for weight in codec.parameters()),
    )
