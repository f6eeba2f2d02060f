"""`hide_scenes`: hide L messages in one cover while the cover's scene is fitted (sections 3.3 and 4.6)."""

from __future__ import annotations

from typing import ClassVar

import torch
from pydantic import Field

from opencl.routes import describe_drawing
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, stage
from stages.hiding.method_names import module_of
from stages.hiding.storage import write_container, write_secret
from stages.imaging.metric_table import write_rows
from stages.scene.message_views import read_message_pictures
from stages.scene.scene import read_scene
from stages.training.hiding import HidingParameters, hiding_training
from stages.training.objectives import hiding_terms
from stages.training.session import train
from stages.training.views import training_views


class HideScenesParameters(HidingParameters):
    """Parameters specific to hiding scenes."""

    hides_scenes: ClassVar[bool] = True

    hidden: int | None = Field(
        None, ge=0, description="Number of messages to hide, starting with the first; null: all of them."
    )
    message_points: int = Field(
        0, ge=0, description="Number of points of each message to add at the start. The paper: 0; homogeneous: 4000."
    )


@stage(
    inputs={
        "cover": Input("scene"),
        "messages": Input("views", many=True, optional=True),
        "key": Input("key", optional=True),
    },
    outputs={
        "container": Output("container", privacy="public"),
        "secret": Output("secret", privacy="private"),
        "curves": Output("metrics"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def hide_scenes(context: Context, parameters: HideScenesParameters) -> None:
    """Fit the cover and hide the messages in it; without messages, fit the cover alone by the same method."""
    torch.set_num_threads(parameters.threads)
    cover = read_scene(context.input("cover"))
    given = context.input_many("messages")
    _refuse_too_few(parameters.hidden, len(given))
    messages = read_message_pictures(given[: parameters.hidden], cover.cameras.names)
    training = hiding_training(
        parameters,
        cover,
        list(messages),
        training_views(cover, {name: views.pictures for name, views in messages.items()}),
        hiding_terms(
            list(messages), parameters.lambda_message, parameters.ssim_weight_cover, parameters.ssim_weight_message
        ),
        context.input_optional("key"),
        messages,
        parameters.message_points,
    )
    curves = train(context, training)
    write_container(context.output("container"), training.gaussians, training.method)
    write_secret(context.output("secret"), training.method, list(messages))
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(training.device), gaussians=len(training.gaussians))


def _refuse_too_few(hidden: int | None, given: int) -> None:
    if hidden is not None and hidden > given:
        raise UserError(
            "hidden exceeds the number of messages given",
            found=f"hidden: {hidden}, {given} messages",
            expected=f"hidden: at most {given}",
            remedy="Give hide_scenes more messages, or leave hidden out to hide all of them.",
        )
