"""`probe_secrecy`: how well the message can be read without the secret, and by whom."""

from __future__ import annotations

from typing import Annotated

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import write_comparisons
from stages.analysis.measurements import write_measurements
from stages.analysis.secrecy.probing import Probe, SecrecySettings
from stages.analysis.secrecy.readers import refuse_unreadable
from stages.analysis.secrecy.surrogate import SurrogateSettings
from stages.analysis.seeds import DistinctSeeds
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import open_container
from stages.hiding.storage import check_method, read_gaussians, read_method
from stages.scene.attributes import strings
from stages.scene.message_views import read_messages
from stages.scene.scene import read_scene
from stages.training.threads import Threads


class ProbeSecrecyParameters(Parameters):
    """How many decoders are tried, and how surrogates are trained."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    wrong_decoders: int = Field(
        20, ge=1, description="Number of decoders with random weights to try, and of decoders with another key."
    )
    start_seed: int | None = Field(
        None,
        ge=0,
        description="The training's seed, if it had no key; the decoder's initial weights are then tried, too.",
    )
    shares: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(
        (0.0, 0.01, 0.05, 0.2), description="Shares of training views with leaked messages, each from 0 to 1."
    )
    seeds: DistinctSeeds = Field(
        (0, 1, 2), min_length=1, description="Random seeds for the surrogates' leaked views and initial weights."
    )
    steps: int = Field(1000, ge=1, description="Adam steps for each surrogate.")
    crop: int = Field(32, ge=8, description="Side of the square crop used in each step, in pixels.")
    rate: float = Field(
        1e-3,
        gt=0,
        description="Adam's initial learning rate; it decays to 0. At 1e-2, decoders with 3 x 3 convolutions die.",
    )
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container"),
        "secret": Input("secret"),
        "cover": Input("scene"),
        "messages": Input("views", many=True),
        "clean": Input("container", optional=True),
    },
    outputs={
        "measurements": Output("measurements", privacy="private"),
        "pictures": Output("comparisons", privacy="private"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def probe_secrecy(context: Context, parameters: ProbeSecrecyParameters) -> None:
    """Read the message with wrong decoders, with surrogates trained on leaked views, and from the features as they are.

    `clean` is a container of the same method and cover that hides nothing: the control for chance correlations. All
    figures are of test views, which no attacker has seen. A sealed container is opened only for the owner. Raises
    `UserError` unless the container hides something, there are views of each of its messages, and its message decoder
    can read what others rendered (`refuse_unreadable`).
    """
    torch.set_num_threads(parameters.threads)
    container, secret, clean = context.input("container"), context.input("secret"), context.input_optional("clean")
    scene = read_scene(context.input("cover"))
    views = read_messages(context.input_many("messages"), scene.cameras.names)
    messages = {name: views[name] for name in strings(secret, "messages") if name in views}
    check_method(container, parameters.method)
    if len(messages) != len(strings(secret, "messages")) or not messages:
        raise UserError(
            "the hidden messages cannot be compared with anything",
            found=f"views for {len(messages)} of the {len(strings(secret, 'messages'))} that the container hides",
            expected="at least one hidden message, and views for each",
            remedy="give probe_secrecy the container and the secret of one training, and its messages",
        )
    if clean is not None:
        check_method(clean, parameters.method)
    surrogates = SurrogateSettings(parameters.steps, parameters.crop, parameters.rate)
    gaussians, owner = read_gaussians(container), read_method(container, secret)
    refuse_unreadable(owner)
    probe = Probe(
        gaussians=gaussians,
        unsealed=open_container(gaussians, owner, secret),
        public=read_method(container),
        owner=owner,
        scene=scene,
        messages=messages,
        clean=(read_gaussians(clean), read_method(clean)) if clean is not None else None,
        settings=SecrecySettings(
            parameters.wrong_decoders, parameters.start_seed, parameters.shares, parameters.seeds, surrogates
        ),
        device=working_device(),
    )

    rows, pictures = probe.run(context.progress_or_stop)
    write_measurements(context.output("measurements"), rows)
    write_comparisons(context.output("pictures"), pictures)
    context.record(device=describe_drawing(probe.device))
