"""`imprint_watermark`: a container whose renders carry a watermark, and the decoder that sees it, tuned together.

Ours, beside the paper's RTWS (`finetune_rtws`, then `tune_watermark_decoder`): what watermarked photos carry hardly
reaches Gaussians that are fitted to them, and a decoder that is tuned afterwards learns to tell renders from photos.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field, field_validator

from opencl.device import choose_device
from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.method import module_of
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container
from stages.hiding.watermark.rendering import renders
from stages.hiding.watermark.storage import read_codec, write_codec
from stages.hiding.what_is_hidden import hidden_messages
from stages.imaging.image import filling, read_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.shipped_photos import DIGESTS, installed_photos, read_photo
from stages.scene.message_views import read_messages
from stages.scene.scene import TEST_VIEW_EVERY, Scene, read_scene
from stages.train_codec import HELD_OUT
from stages.training.codec_photos import read_photos
from stages.training.hidden_image import hidden_image
from stages.training.imprinting import Imprinting, ImprintPictures, ImprintSettings
from stages.training.network import train_network
from stages.training.views import training_views

LEARNT_FROM = tuple(name for name in DIGESTS if name not in HELD_OUT)
"""Shipped photos that must show black; the others are left to try the decoder on."""


class ImprintWatermarkParameters(Parameters):
    """How strong the mark is, and how long it is learnt."""

    method: str = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    iterations: int = Field(4000, ge=1, description="Steps; each sees one training view, and pictures that show black.")
    feature_rate: float = Field(
        5e-3, gt=0, description="First learning rate of features, or of the constant harmonic: what a hiding ends with."
    )
    decoder_rate: float = Field(1e-3, gt=0, description="First learning rate of the watermark decoder.")
    final_rate_share: float = Field(0.1, gt=0, le=1, description="Share of both rates that is left at the end.")
    watermark_weight: float = Field(
        0.03, gt=0, description="First weight of the watermark's squared error beside the cover's."
    )
    final_watermark_weight: float = Field(
        0.002, gt=0, description="Its last weight; the smaller, the fainter the mark."
    )
    settling_share: float = Field(0.6, gt=0, le=1, description="Share of the steps in which the weight falls.")
    lambda_message: float = Field(0.1, ge=0, description="λ: the message's weight, where it is given.")
    distorted: bool = Field(False, description="Whether pictures are distorted at random before they are read.")
    shipped_photos: tuple[str, ...] = Field(
        LEARNT_FROM, description="Photos that packages ship, by their files' names, that must show black, too."
    )
    seed: int = Field(0, ge=0, description="Of the pictures' order, and of distortions.")
    threads: int = Field(1, ge=1, description="Threads of torch: sums over pixels, and so the bits, depend on it.")

    @field_validator("shipped_photos")
    @classmethod
    def _as_installed(cls, wanted: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for name in wanted if name in installed_photos())


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "codec": Input("codec"),
        "watermark": Input("image"),
        "secret": Input("secret", optional=True),
        "image": Input("image", optional=True),
        "messages": Input("views", many=True, optional=True),
        "photos": Input("capture", many=True, optional=True),
    },
    outputs={
        "container": Output("container", privacy="public"),
        "codec": Output("codec", privacy="private"),
        "curves": Output("metrics", privacy="private"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def imprint_watermark(context: Context, parameters: ImprintWatermarkParameters) -> None:
    """Change the Gaussians' features, and tune the decoder, until renders of the cover show the watermark.

    Photos of the cover, renders from before, and `photos` of anything else show black. Positions, shapes, opacities and
    the container's own decoders stay as they are. A message that is given, as `evaluate` takes it, with its secret, is
    held on to. The decoder that comes out is the owner's alone: whoever has it can change a picture until it shows
    nothing.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input_optional("secret")
    check_method(container, parameters.method)
    scene, codec = read_scene(context.input("cover")), read_codec(context.input("codec"))
    gaussians, method = read_gaussians(container), read_method(container, secret)
    pictures = ImprintPictures(
        training_views(scene, _messages(context, scene, secret)),
        renders(gaussians, method, scene.cameras.select(scene.train_names), context.stop_if_requested),
        filling(read_image(context.input("watermark"))[1], scene.cameras.width, scene.cameras.height),
        _other_photos(context, parameters),
        hidden_image(context.input_optional("image"), secret, scene, parameters.lambda_message, 0, "imprint_watermark"),
    )
    codec.expect(picture_to_tensor(pictures.watermark).permute(2, 0, 1))
    curves = train_network(context, Imprinting(gaussians, method, codec, pictures, _settings(parameters)))
    write_container(context.output("container"), gaussians, method)
    write_codec(context.output("codec"), codec)
    write_rows(context.output("curves"), curves)
    context.record(device=choose_device().describe())


def _messages(context: Context, scene: Scene, secret: Artifact | None) -> dict[str, UInt8[np.ndarray, "V H W 3"]]:
    given = read_messages(context.input_many("messages"), scene.cameras.names)
    return {name: message.pictures for name, message in hidden_messages(given, secret).items()}


def _other_photos(context: Context, parameters: ImprintWatermarkParameters) -> list[Picture]:
    """Captures lose every eighth photo, as `train_codec` has it."""
    captures = [read_photos(artifact) for artifact in context.input_many("photos")]
    learnt = [photo for photos in captures for row, photo in enumerate(photos) if row % TEST_VIEW_EVERY]
    return learnt + [read_photo(name) for name in parameters.shipped_photos]


def _settings(parameters: ImprintWatermarkParameters) -> ImprintSettings:
    return ImprintSettings(
        parameters.iterations,
        parameters.seed,
        parameters.feature_rate,
        parameters.decoder_rate,
        parameters.final_rate_share,
        parameters.watermark_weight,
        parameters.final_watermark_weight,
        parameters.settling_share,
        parameters.lambda_message,
        parameters.distorted,
    )
