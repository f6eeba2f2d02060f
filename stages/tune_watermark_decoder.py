"""`tune_watermark_decoder`: tune D_w to tell renders of a container from other pictures (RTWS, second half)."""

from __future__ import annotations

from itertools import chain
from typing import Literal

import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.storage import check_drawn, read_gaussians, read_method
from stages.hiding.watermark.rendering import renders
from stages.hiding.watermark.storage import read_codec, write_codec
from stages.imaging.image import filling, read_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.shipped_photos import ShippedPhotos, longest_for
from stages.scene.between import cameras_between
from stages.scene.cameras import Cameras
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import read_scene
from stages.training.codec_photos import learnt_photos
from stages.training.decoder_tuning import CLEAN, PHOTOS, RENDERS, DecoderTuning, TuningSettings
from stages.training.network import train_network
from stages.training.threads import Threads


class TuneWatermarkDecoderParameters(Parameters):
    """The paper's loss (Eq. 8), and what may be added to it."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    negatives: Literal["photos", "photos_and_clean_renders"] = Field(
        "photos",
        description="What the decoder learns to show black for: the training views' photos, as in the paper, or also "
        "renders of the container from before it was watermarked.",
    )
    shipped_photos: ShippedPhotos = Field(
        (), description="File names of photos shipped with Python packages that must also show black."
    )
    black_weight: float = Field(
        1.0,
        gt=0,
        description="Weight of each kind of picture that must show black, relative to renders; the paper's is 1.",
    )
    whole_pictures: bool = Field(
        False,
        description="Whether the decoder decides from the whole picture, unlike the paper's. It then finds fainter "
        "marks, but no longer shows which part of a picture has one.",
    )
    tinted: bool = Field(False, description="Whether pictures are randomly tinted, unlike in the paper.")
    distorted: bool = Field(False, description="Whether pictures are randomly distorted, unlike in the paper.")
    iterations: int = Field(
        400,
        ge=1,
        description="Training steps; each uses one picture of every kind, except for renders and other photos: "
        "`batch` each.",
    )
    batch: int = Field(1, ge=1, description="Watermarked renders, and crops of other photos, per step.")
    hardest_of: int = Field(
        1,
        ge=1,
        description="Each crop of other photos is the hardest of this many: the one in which the decoder shows most.",
    )
    between: int = Field(
        0,
        ge=0,
        description="Number of extra cameras between the training views whose renders, watermarked and clean, are also "
        "learnt from.",
    )
    evenly: bool = Field(
        False,
        description="Whether crops are drawn evenly per scene instead of per photo; a capture is one scene, and so is "
        "each shipped photo.",
    )
    rate: float = Field(1e-3, gt=0, description="Adam's initial learning rate.")
    final_rate_share: float = Field(0.1, gt=0, le=1, description="Final learning rate as a share of the initial one.")
    seed: int = Field(0, ge=0, description="Random seed for picture order and distortions.")
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container"),
        "before": Input("container or splats", optional=True),
        "cover": Input("scene"),
        "codec": Input("codec"),
        "watermark": Input("image"),
        "photos": Input("capture", many=True, optional=True),
    },
    outputs={"codec": Output("codec", privacy="private"), "curves": Output("metrics", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def tune_watermark_decoder(context: Context, parameters: TuneWatermarkDecoderParameters) -> None:
    """Tune the decoder to show the watermark in the container's renders of training views, and black in their photos.

    It can also learn to show black in clean renders (`negatives`) and in other `photos`; without these, the decoder of
    an imprint, which learnt from them, would forget them. Renders are rounded to 8 bits, as in files. Keep the
    resulting decoder secret: anyone who has it can alter a picture until it shows nothing.
    """
    torch.set_num_threads(parameters.threads)
    container, before = context.input("container"), _before(context, parameters)
    check_drawn(container, parameters.method, context.input("cover"))
    if before is not None:
        check_drawn(before, parameters.method, context.input("cover"))
    scene = read_scene(context.input("cover"))
    cameras = scene.cameras.select(learnt_names(scene))
    watermark = filling(read_image(context.input("watermark"))[1], cameras.width, cameras.height)
    device = working_device()
    between = cameras_between(cameras, parameters.between, np.random.default_rng(parameters.seed))

    def seen(drawn: Artifact) -> UInt8[np.ndarray, "V H W 3"]:
        return np.concatenate([_renders(context, drawn, each, device) for each in (cameras, between)])

    pictures = {
        RENDERS: seen(container),
        PHOTOS: scene.pictures[scene.rows(scene.train_names)],
    }
    if before is not None:
        pictures[CLEAN] = seen(before)
    codec = read_codec(context.input("codec")).to(device)
    codec.expect(picture_to_tensor(watermark, device))
    if parameters.whole_pictures:
        codec.see_whole_pictures()
    longest = longest_for(scene.cameras.width, scene.cameras.height)
    scenes = learnt_photos(context.input_many("photos"), parameters.shipped_photos, context.log, longest)
    others = scenes if parameters.evenly else [[photo] for photo in chain(*scenes)]
    curves = train_network(context, DecoderTuning(codec, watermark, pictures, _settings(parameters), others))
    write_codec(context.output("codec"), codec)
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(device))


def _settings(parameters: TuneWatermarkDecoderParameters) -> TuningSettings:
    return TuningSettings(
        iterations=parameters.iterations,
        seed=parameters.seed,
        distorted=parameters.distorted,
        rate=parameters.rate,
        final_rate=parameters.rate * parameters.final_rate_share,
        batch=parameters.batch,
        tinted=parameters.tinted,
        black_weight=parameters.black_weight,
        hardest_of=parameters.hardest_of,
    )


def _before(context: Context, parameters: TuneWatermarkDecoderParameters) -> Artifact | None:
    """What clean renders are of; None if none are learnt from. Raises `UserError` if it is needed and not given."""
    if parameters.negatives != "photos_and_clean_renders":
        return None
    before = context.input_optional("before")
    if before is None:
        raise UserError(
            "there are no clean renders to learn from",
            found="no container from before it was watermarked",
            remedy="give tune_watermark_decoder the input before, or choose negatives: photos",
        )
    return before


def _renders(
    context: Context, container: Artifact, cameras: Cameras, device: torch.device
) -> UInt8[np.ndarray, "V H W 3"]:
    gaussians, read = read_gaussians(container, device), read_method(container, device=device)
    return renders(gaussians, read, cameras, context.stop_if_requested)
