"""`hide_image`: hide one image in one view of the cover while the cover's scene is fitted (section 4.6)."""

from __future__ import annotations

import torch
from pydantic import Field

from opencl.routes import describe_drawing
from pipeline.artifact import Artifact
from pipeline.errors import UserError, nearest
from pipeline.stage import Context, Input, Output, stage
from stages.hiding.key import generator_apart
from stages.hiding.method_names import module_of
from stages.hiding.storage import write_container, write_secret
from stages.imaging.image import read_image
from stages.imaging.metric_table import write_rows
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene, read_scene
from stages.training.hidden_image import hidden_image
from stages.training.hiding import HidingParameters, hiding_training
from stages.training.objectives import PictureTerm, cover_term
from stages.training.session import train
from stages.training.views import training_views


class HideImageParameters(HidingParameters):
    """Parameters specific to hiding an image."""

    lambda_message: float = Field(0.1, ge=0, description="λ: the image's weight in the total loss.")
    view: str | None = Field(
        None,
        description="Name of the training view that hides the image. If not set, the key chooses one; without a key, "
        "it is the middle one, which anyone can guess.",
    )


@stage(
    inputs={"cover": Input("scene"), "image": Input("image"), "key": Input("key", optional=True)},
    outputs={
        "container": Output("container", privacy="public"),
        "secret": Output("secret", privacy="private"),
        "curves": Output("metrics"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def hide_image(context: Context, parameters: HideImageParameters) -> None:
    """Fit the cover, and in each iteration compare the message decoder's output at one view with the image.

    The image is scaled to fill the view's picture, and cropped. The decoder's output at other views is not constrained.
    """
    torch.set_num_threads(parameters.threads)
    cover = read_scene(context.input("cover"))
    name, picture = read_image(context.input("image"))
    view = chosen_view(cover, parameters.view, context.input_optional("key"))
    term = PictureTerm(name, parameters.lambda_message, parameters.ssim_weight_message)
    training = hiding_training(
        parameters,
        cover,
        [name],
        training_views(cover),
        [cover_term(parameters.ssim_weight_cover)],
        context.input_optional("key"),
        fixed=[hidden_image(term, picture, cover.cameras, view)],
    )
    curves = train(context, training)
    write_container(context.output("container"), training.gaussians, training.method)
    write_secret(context.output("secret"), training.method, [name], image_view=view)
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(training.device), gaussians=len(training.gaussians))


def chosen_view(cover: Scene, wanted: str | None, key: Artifact | None) -> str:
    """The training view that hides the image: `wanted`, if given, else the key's choice, else the middle one.

    The key's choice is independent of the training's random numbers. Raises `UserError` if `wanted` is not a training
    view, and if there is no training view.
    """
    names = learnt_names(cover)
    if wanted is None and key is not None:
        return names[generator_apart(key, "view").integers(len(names))]
    if wanted is None:
        return names[len(names) // 2]
    if wanted not in names:
        raise UserError(
            "the view to hide the image in is not a training view",
            found=wanted,
            expected=f"one of the {len(names)} training views{nearest(wanted, names)}",
        )
    return wanted
