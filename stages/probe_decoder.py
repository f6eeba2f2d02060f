"""`probe_decoder`: what the message decoder shows for features that hold no message."""

from __future__ import annotations

import torch
from pydantic import Field

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.probes import RawFeatures, probes
from stages.analysis.probing import probe_rows
from stages.hiding.coupled import FEATURES
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import read_container
from stages.hiding.storage import check_method, read_gaussians
from stages.hiding.what_is_hidden import at_least_one_hidden
from stages.imaging.metric_table import write_rows
from stages.scene.message_views import read_messages
from stages.scene.scene import read_scene
from stages.training.threads import Threads


class ProbeDecoderParameters(Parameters):
    """The containers' method, and the seed of random choices."""

    method: MethodName = Field("gs_hider", description="The containers' method.")
    seed: int = Field(
        0, ge=0, description="Random seed for the silenced channels and the placement of foreign features."
    )
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container"),
        "secret": Input("secret"),
        "cover": Input("scene"),
        "messages": Input("views", many=True),
        "other": Input("container", optional=True),
    },
    outputs={"scores": Output("metrics", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def probe_decoder(context: Context, parameters: ProbeDecoderParameters) -> None:
    """Score the message on test views as decoded from the container's own features, and from others (`probes`).

    Raises `UserError` for a method without coupled features, and if the container hides none of the `messages`.
    """
    torch.set_num_threads(parameters.threads)
    container, other = context.input("container"), context.input_optional("other")
    check_method(container, parameters.method)
    scene = read_scene(context.input("cover"))
    secret = context.input("secret")
    messages = read_messages(context.input_many("messages"), scene.cameras.names)
    messages = at_least_one_hidden(messages, secret, "probe_decoder")
    read = read_container(container, secret)
    gaussians, method = read.gaussians, read.method
    if FEATURES not in gaussians.parameters:
        raise UserError(
            "the container has no features to probe",
            where=str(container.path),
            found=f"method {parameters.method}",
            expected="a method with coupled features, such as gs_hider",
        )
    foreign = None if other is None else _features_of(other, gaussians[FEATURES].shape[1])
    features = probes(gaussians[FEATURES], foreign, parameters.seed)
    rows = probe_rows(gaussians, method, parameters.method, scene, messages, features, context.stop_if_requested)
    write_rows(context.output("scores"), rows)


def _features_of(other: Artifact, channels: int) -> RawFeatures:
    """The other container's features. Raises `UserError` if it has none, or another number of channels."""
    features = read_gaussians(other).parameters.get(FEATURES)
    if features is None or features.shape[1] != channels:
        raise UserError(
            "the decoder cannot read the other container's features",
            where=str(other.path),
            found="none" if features is None else f"{features.shape[1]} for each Gaussian",
            expected=f"{channels} for each Gaussian",
            remedy="give probe_decoder as `other` a container of the same method and feature_dim, or none",
        )
    return features
