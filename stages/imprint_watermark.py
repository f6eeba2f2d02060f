"""`imprint_watermark`: tune a container and the watermark decoder together, so that renders show the watermark.

Our alternative to the paper's RTWS (`finetune_rtws`, then `tune_watermark_decoder`). Where that was measured (3DGS, the
fox: `workflows/figures/rtws.md`), hardly anything of watermarked photos reached the Gaussians that were fitted to them,
and the decoder tuned afterwards learned to tell renders from photos.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from itertools import chain

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import generator_apart, key_generator
from stages.hiding.method import Method
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import refuse_sealed
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import check_drawn, read_gaussians, read_method, write_container
from stages.hiding.watermark.coins import thrown
from stages.hiding.watermark.grain import grained, level_shown, measuring_cameras
from stages.hiding.watermark.storage import read_codec, write_codec
from stages.hiding.what_is_hidden import view_of_an_image
from stages.imaging.image import filling, read_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import Picture, picture_to_tensor, tensor_to_picture
from stages.imaging.shipped_photos import SAMPLES_LEARNT_FROM, ShippedPhotos, longest_for
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene, read_scene
from stages.training.codec_photos import learnt_photos
from stages.training.feature_tuning import refuse_unknown_attributes
from stages.training.imprinting import Imprinting, ImprintPictures, ImprintSettings
from stages.training.loop import TrainingViews
from stages.training.network import train_network
from stages.training.threads import Threads


class ImprintWatermarkParameters(Parameters):
    """Strength and training of the imprint. Levels are root mean squares over a picture, in levels of 255."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    level: float = Field(
        2.5, gt=0, description="Maximum change of the cover's render in any training view; larger is easier to detect."
    )
    first_level: float = Field(20, gt=0, description="Level at the start, added as grain.")
    message_level: float = Field(0.75, gt=0, description="Maximum change of the messages that the secret shows.")
    iterations: int = Field(
        4000, ge=1, description="Optimisation steps; each uses one training view and pictures that must show black."
    )
    settling_share: float = Field(
        0.7, gt=0, le=1, description="Share of the steps over which the level falls from first_level to level."
    )
    feature_rate: float = Field(
        5e-3,
        gt=0,
        description="Initial learning rate of features, or of the SH DC term; by default, the final rate of features "
        "in hiding.",
    )
    decoder_rate: float = Field(1e-3, gt=0, description="Initial learning rate of the watermark decoder.")
    final_rate_share: float = Field(
        0.05, gt=0, le=1, description="Final value of both rates as a share of the initial one."
    )
    distorted: bool = Field(False, description="Whether pictures are also randomly distorted before decoding.")
    shipped_photos: ShippedPhotos = Field(
        SAMPLES_LEARNT_FROM, description="File names of photos shipped with Python packages that must also show black."
    )
    seed: int = Field(
        0, ge=0, description="Random seed for picture order and distortions and, without a key, for the grain."
    )
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "codec": Input("codec"),
        "watermark": Input("image"),
        "secret": Input("secret", optional=True),
        "key": Input("key", optional=True),
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
    """Optimise the Gaussians' features and the decoder until renders of the cover show the watermark.

    The decoder learns to show black for photos of the cover, renders from before, and `photos` of anything else.
    Positions, shapes, opacities and the container's own decoders stay as they are. With the secret, what it shows may
    change by at most `message_level`. Keep the resulting decoder secret: anyone who has it can alter a picture until it
    shows nothing. Raises `UserError` if the secret is that of a sealed container; without the secret this cannot be
    told.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input_optional("secret")
    check_drawn(container, parameters.method, context.input("cover"))
    device = working_device()
    scene, codec = read_scene(context.input("cover")), read_codec(context.input("codec")).to(device)
    refuse_sealed(secret, "imprint_watermark")
    gaussians, method = read_gaussians(container, device), read_method(container, secret, device)
    refuse_unknown_attributes(gaussians, method, "imprint_watermark")
    pictures = _pictures(context, parameters, scene, gaussians, method)
    codec.expect(picture_to_tensor(pictures.watermark, device))
    key = context.input_optional("key")
    coins = thrown(len(gaussians), key_generator(key, parameters.seed))
    dither = generator_apart(key, "dither", parameters.seed)
    cameras, level, stop = measuring_cameras(scene), parameters.first_level, context.stop_if_requested
    marked = grained(gaussians, method, cameras, level, coins, dither, stop)
    context.record(
        first_level_shown=round(level_shown(gaussians, marked, method, cameras, level, context.log, stop), 3)
    )
    curves = train_network(context, Imprinting(marked, gaussians, method, codec, pictures, _settings(parameters)))
    write_container(context.output("container"), marked, method)
    write_codec(context.output("codec"), codec)
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(device))


def _pictures(
    context: Context, parameters: ImprintWatermarkParameters, scene: Scene, gaussians: Gaussians, method: Method
) -> ImprintPictures:
    cameras = scene.cameras
    longest = longest_for(cameras.width, cameras.height)
    before = _views(gaussians, method, cameras.select(learnt_names(scene)), context.stop_if_requested)
    view = view_of_an_image(context.input_optional("secret"), scene, "imprint_watermark")
    image = None
    if view is not None:
        # What its decoder shows at other views is arbitrary and need not be preserved.
        image = _only(_views(gaussians, method, cameras.select([view]), context.stop_if_requested), cover=False)
        before = _only(before, cover=True)
    return ImprintPictures(
        before,
        [scene.pictures[row] for row in scene.rows(scene.train_names)],
        filling(read_image(context.input("watermark"))[1], cameras.width, cameras.height),
        [*chain(*learnt_photos(context.input_many("photos"), parameters.shipped_photos, context.log, longest))],
        image,
    )


def _views(gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None]) -> TrainingViews:
    """All pictures that the container shows from these cameras, in 8 bits."""
    shown: list[dict[str, Picture]] = []
    for rendering in photographs(gaussians, method, cameras):
        shown.append({name: tensor_to_picture(picture) for name, picture in rendering.pictures.items()})
        after_each()
    pictures = {name: [torch.from_numpy(each[name]) for each in shown] for name in shown[0]}
    return TrainingViews(single_cameras(cameras), pictures)


def _only(views: TrainingViews, cover: bool) -> TrainingViews:
    """The views with only the cover's pictures, or with all pictures but these."""
    return TrainingViews(
        views.cameras, {name: each for name, each in views.pictures.items() if (name == COVER) == cover}
    )


def _settings(parameters: ImprintWatermarkParameters) -> ImprintSettings:
    names = (field.name for field in fields(ImprintSettings))
    return ImprintSettings(**{name: getattr(parameters, name) for name in names})
