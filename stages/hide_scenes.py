"""`hide_scenes`: GS-Hider (section 3.3), L messages hidden in one cover while the cover's scene is fitted."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import torch
from pydantic import Field

from opencl.device import choose_device
from pipeline.stage import Context, Input, Output, stage
from stages.hiding.key import key_generator
from stages.hiding.method import Method, build_method, module_of
from stages.hiding.storage import write_container, write_secret
from stages.imaging.metric_table import write_rows
from stages.scene.cameras import rig_extent
from stages.scene.gaussians import gaussians_at
from stages.scene.message_views import read_messages
from stages.scene.scene import read_scene
from stages.training.loop import Training
from stages.training.objectives import hiding_terms
from stages.training.parameters import TrainingParameters
from stages.training.session import train
from stages.training.starting_points import starting_points
from stages.training.views import training_views


class HideScenesParameters(TrainingParameters):
    """The paper's symbols: M is `feature_dim`, λ `lambda_message`, γ and β the two SSIM weights."""

    method: Literal["gs_hider", "homogeneous"] = Field(
        "gs_hider", description="How Gaussians become pictures: as in the paper, or with features divided by shares."
    )
    feature_dim: int = Field(16, ge=1, description="M: channels of the coupled feature of each Gaussian.")
    layers: int = Field(5, ge=2, description="Convolutions in each decoder.")
    decoder_width: int = Field(64, ge=1, description="Channels between the decoders' convolutions.")
    lambda_message: float = Field(0.5, ge=0, description="λ: the messages' weight in the total loss.")
    ssim_weight_cover: float = Field(0.2, ge=0, le=1, description="γ: SSIM's share of the cover's loss.")
    ssim_weight_message: float = Field(0.2, ge=0, le=1, description="β: SSIM's share of a message's loss.")
    message_points: int = Field(
        0, ge=0, description="Start with this many points of each message, too. The paper: none."
    )
    feature_rate: float = Field(
        5e-2, gt=0, description="Learning rate of features. Released code: 2.5e-3, with 50,000 iterations."
    )
    network_rate: float = Field(1e-3, gt=0, description="Learning rate of the decoders.")
    final_rate_share: float = Field(
        0.1, gt=0, le=1, description="Share of both rates that is left at the end. Released code: 1."
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="Of the convolutions between a decoder's first and last. Where the CPU has it, bfloat16 takes 0.7 "
        "of an iteration's time, and costs the message 0.1 to 0.2 dB. "
        "Either gives the same bits every time for one number of threads.",
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
    """Fit the cover and hide the messages; without messages, the cover alone is fitted by the same method."""
    torch.set_num_threads(parameters.threads)
    cover = read_scene(context.input("cover"))
    messages = read_messages(context.input_many("messages"), cover.cameras.names)
    method = _build(parameters, list(messages))
    points, colors = starting_points(cover, messages, parameters.start(parameters.message_points))
    generator = key_generator(context.input_optional("key"), parameters.seed)
    training = Training(
        gaussians_at(points, method.initial_attributes(colors, generator)),
        method,
        training_views(cover, {name: views.pictures for name, views in messages.items()}),
        hiding_terms(
            list(messages),
            parameters.lambda_message,
            parameters.ssim_weight_cover,
            parameters.ssim_weight_message,
        ),
        replace(
            parameters.settings(rig_extent(cover.cameras)),
            attribute_rates={"raw_features": parameters.feature_rate},
            network_rate=parameters.network_rate,
            final_rate_share=parameters.final_rate_share,
        ),
    )
    curves = train(context, training)
    write_container(context.output("container"), training.gaussians, method)
    write_secret(context.output("secret"), method, list(messages))
    write_rows(context.output("curves"), curves)
    context.record(device=choose_device().describe(), gaussians=len(training.gaussians))


def _build(parameters: HideScenesParameters, messages: list[str]) -> Method:
    settings = parameters.model_dump(include={"feature_dim", "layers", "decoder_width", "precision"})
    with torch.random.fork_rng():
        torch.manual_seed(parameters.seed)
        return build_method(parameters.method, settings | {"messages": messages})
