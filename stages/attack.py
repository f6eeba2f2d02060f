"""`attack`: attacks on a published container, and the quality of cover and messages that they leave."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import torch
from pydantic import Field, field_validator

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.attacks.catalogue import ATTACKS, UNATTACKED, AttackName
from stages.analysis.attacks.curves import Assay
from stages.analysis.attacks.registry import attacks
from stages.analysis.attacks.scoring import Scorer
from stages.analysis.attacks.target import Knowledge, Target
from stages.analysis.kept import kept, name_on
from stages.analysis.measurements import KIND, write_measurements
from stages.analysis.seeds import DistinctSeeds
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import opener
from stages.hiding.storage import check_method, read_gaussians, read_method
from stages.hiding.what_is_hidden import at_least_one_hidden
from stages.imaging.lpips import lpips_metrics
from stages.imaging.lpips_weights import weights_installed
from stages.scene.cameras import rig_extent
from stages.scene.even_spread import evenly_spread
from stages.scene.message_views import read_messages
from stages.scene.scene import Scene, read_scene
from stages.training.threads import Threads
from stages.training.views import training_views


class AttackParameters(Parameters):
    """Which attacks are run, how strong they are, and how their effect is measured."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    attacks: tuple[AttackName, ...] = Field(tuple(ATTACKS), min_length=1, description="The attacks, in order.")
    cover_losses: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        (0.25, 0.5, 1.0, 2.0, 4.0),
        min_length=1,
        description="Target losses of the cover on test views, in dB. The severity of each attack is chosen to match, "
        "except for attacks with natural severities, such as bits. Losses that an attack cannot cause give way to "
        "smaller ones.",
    )
    seeds: DistinctSeeds = Field((0, 1, 2), min_length=1, description="Random seeds for the attacks.")
    reoptimised: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (100, 200, 300, 400, 500),
        min_length=1,
        description="Numbers of re-optimisation iterations after which to measure.",
    )
    test_views: int = Field(12, ge=1, description="Maximum number of test views to measure, evenly spread.")
    lpips: bool = Field(
        True, description="Report LPIPS (VGG16) of the cover in the paper's table, if its weights are installed."
    )
    threads: Threads = 1

    @field_validator("lpips")
    @classmethod
    def _as_installed(cls, wanted: bool) -> bool:
        return wanted and weights_installed("vgg")


@stage(
    inputs={
        "container": Input("container"),
        "secret": Input("secret"),
        "cover": Input("scene"),
        "messages": Input("views", many=True),
    },
    outputs={"measurements": Output(KIND, privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def attack(context: Context, parameters: AttackParameters) -> None:
    """Attack the container in every way listed in `attacks`, and measure cover and messages on test views.

    Messages are read from the attacked container as it is, and again after the owner has registered it with the
    published one, as `recover` does. A sealed container is attacked as published; for both readings, the owner opens
    what is left of it with the help of the published one. Raises `UserError` if the container hides none of the
    `messages`.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input("secret")
    check_method(container, parameters.method)
    scene = read_scene(context.input("cover"))
    messages = read_messages(context.input_many("messages"), scene.cameras.names)
    hidden, device = at_least_one_hidden(messages, secret, "attack"), working_device()
    drawn_by = describe_drawing(device)
    target, owner = Target(read_gaussians(container), read_method(container)), read_method(container, secret)
    opened = opener(owner, secret, target.gaussians)
    rig = scene.cameras
    assay = Assay(
        target,
        Scorer(owner, scene, hidden, _measured_views(scene, parameters.test_views), device, opened),
        Knowledge(training_views(scene), rig_extent(rig), context.stop_if_requested, device),
        parameters.method,
        parameters.cover_losses,
        parameters.seeds,
        lpips_metrics(["vgg"] if parameters.lpips else [], rig.width, rig.height, device, context.log),
        context.stop_if_requested,
    )
    every = attacks(parameters.reoptimised)
    chosen = {name: every[name] for name in parameters.attacks}
    rows = list(kept(context.scratch, name_on(drawn_by, UNATTACKED.encode()), assay.unattacked))
    for done, (name, how) in enumerate(chosen.items()):
        context.progress(done, len(chosen))
        rows += kept(context.scratch, name_on(drawn_by, name.encode()), partial(assay.curve, name, how))
    write_measurements(context.output("measurements"), rows)
    context.record(device=drawn_by)


def _measured_views(scene: Scene, most: int) -> list[str]:
    """At most `most` of the test views, evenly spread."""
    names = scene.test_names
    return [names[position] for position in evenly_spread(len(names), most)]
