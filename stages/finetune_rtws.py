"""`finetune_rtws`: fine-tune a container so that its renders carry a watermark (RTWS, first half of appendix A)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import refuse_sealed
from stages.hiding.storage import check_drawn, read_gaussians, read_method, write_container
from stages.hiding.watermark.storage import read_codec
from stages.hiding.what_is_hidden import messages_to_read, view_that_hides
from stages.imaging.image import filling, read_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import picture_to_tensor
from stages.scene.message_views import read_message_pictures
from stages.scene.scene import Scene, read_scene
from stages.training.feature_tuning import (
    FeatureRates,
    feature_training,
    half_watermarked,
    refuse_unknown_attributes,
)
from stages.training.hidden_image import hidden_image
from stages.training.objectives import FixedView, PictureTerm, hiding_terms
from stages.training.session import train
from stages.training.threads import Threads
from stages.training.views import training_views


class FinetuneRtwsParameters(Parameters):
    """Settings of the fine-tuning. The paper gives neither the number of iterations nor learning rates."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    marked: bool = Field(
        True,
        description="Whether half of the views are watermarked. If false, features are trained just as long on "
        "unmarked views: a control that separates the effect of further training from that of the watermark.",
    )
    iterations: int = Field(300, ge=1, description="Optimisation steps, one view each.")
    feature_rate: float = Field(
        5e-3,
        gt=0,
        description="Learning rate of features, or of the SH DC term; by default, the final rate of features "
        "in hiding.",
    )
    final_rate_share: float = Field(0.2, gt=0, le=1, description="Final learning rates as a share of the initial ones.")
    lambda_message: float = Field(0.1, ge=0, description="λ: the message's weight in the loss, if a message is given.")
    ssim_weight: float = Field(0.2, ge=0, le=1, description="γ and β: SSIM's share of each picture's loss.")
    seed: int = Field(
        0, ge=0, description="Random seed for which half of the views is watermarked, and for their order."
    )
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "codec": Input("codec"),
        "watermark": Input("image"),
        "secret": Input("secret", optional=True),
        "image": Input("image", optional=True),
        "messages": Input("views", many=True, optional=True),
    },
    outputs={
        "container": Output("container", privacy="public"),
        "curves": Output("metrics", privacy="private"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def finetune_rtws(context: Context, parameters: FinetuneRtwsParameters) -> None:
    """Watermark half of the training views, and fine-tune the Gaussians' features on all of them.

    Positions, shapes, opacities and the container's decoders stay as they are (the paper does not mention opacities and
    decoders). Messages or an image, given with the secret as for `evaluate`, are part of the loss; without them, the
    features are free to forget what they hide. `tune_watermark_decoder` comes next: one container serves all decoders
    that learn from it. Raises `UserError` if the secret is that of a sealed container (without the secret this cannot
    be told), and if it does not fit the messages or the image.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input_optional("secret")
    refuse_sealed(secret, "finetune_rtws")
    check_drawn(container, parameters.method, context.input("cover"))
    device = working_device()
    scene, codec = read_scene(context.input("cover")), read_codec(context.input("codec")).to(device)
    watermark = filling(read_image(context.input("watermark"))[1], scene.cameras.width, scene.cameras.height)
    given = read_message_pictures(context.input_many("messages"), scene.cameras.names)
    messages = messages_to_read(given, secret, "finetune_rtws")
    fixed = _hidden_image(context.input_optional("image"), secret, scene, parameters)
    gaussians, method = read_gaussians(container, device), read_method(container, secret, device)
    refuse_unknown_attributes(gaussians, method, "finetune_rtws")
    views = training_views(scene, {name: message.pictures for name, message in messages.items()})
    marked: tuple[int, ...] = ()
    if parameters.marked:
        shown = picture_to_tensor(watermark, device)
        views, marked = half_watermarked(views, codec, shown, parameters.seed, context.stop_if_requested)
    terms = hiding_terms([*messages], parameters.lambda_message, parameters.ssim_weight, parameters.ssim_weight)
    rates = FeatureRates(parameters.feature_rate, parameters.final_rate_share)
    training = feature_training(gaussians, method, views, terms, parameters.iterations, rates, parameters.seed, fixed)
    curves = train(context, training)
    write_container(context.output("container"), training.gaussians, method)
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(training.device), watermarked_views=len(marked))


def _hidden_image(
    image: Artifact | None, secret: Artifact | None, scene: Scene, parameters: FinetuneRtwsParameters
) -> Sequence[FixedView]:
    if image is None:
        return ()
    name, picture = read_image(image)
    view = view_that_hides(name, secret, scene, "finetune_rtws")
    term = PictureTerm(name, parameters.lambda_message, parameters.ssim_weight)
    return (hidden_image(term, picture, scene.cameras, view),)
