"""`add_grain`: add a grain to a trained container, which its owner can detect in renders. Our alternative to RTWS."""

from __future__ import annotations

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import generator_apart, key_generator
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import refuse_sealed
from stages.hiding.storage import check_drawn, read_gaussians, read_method, write_container
from stages.hiding.watermark.coins import thrown
from stages.hiding.watermark.grain import grained, level_shown, measuring_cameras
from stages.scene.scene import read_scene
from stages.training.threads import Threads


class AddGrainParameters(Parameters):
    """Strength of the grain, and the source of its coins."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    level: float = Field(
        1.5,
        ge=0,
        description="Strength of the grain in renders: root mean square, in levels of 255. Larger is easier to detect "
        "and more visible; 0 leaves the container unchanged.",
    )
    seed: int = Field(
        0,
        ge=0,
        description="Random seed for the coins that decide how each Gaussian changes, used if there is no key. Not "
        "secret.",
    )
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "secret": Input("secret", optional=True),
        "key": Input("key", optional=True),
    },
    outputs={"container": Output("container", privacy="public")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
    unread={"key": {"level": 0}},
)
def add_grain(context: Context, parameters: AddGrainParameters) -> None:
    """Change every Gaussian's colour a little, with a random sign (its coin); nothing is trained, no decoder changes.

    If the secret is given, features change in a direction that its decoder does not read, which spares the message as
    far as decoders are linear. If a key is given, nobody else knows the coins. `find_grain` reads the grain with the
    container from before: keep that one, and publish the new one, once: two of them, with other levels or by versions
    of this stage that differ, give the coins away. At level 0 nothing changes, bit for bit. Raises `UserError` if the
    secret is that of a sealed container; without the secret this cannot be told.
    """
    torch.set_num_threads(parameters.threads)
    container = context.input("container")
    check_drawn(container, parameters.method, context.input("cover"))
    refuse_sealed(context.input_optional("secret"), "add_grain")
    device, scene = working_device(), read_scene(context.input("cover"))
    method = read_method(container, context.input_optional("secret"), device)
    cameras = measuring_cameras(scene)
    gaussians = read_gaussians(container, device)
    if parameters.level == 0:
        context.log("left unchanged: level is 0, so no grain is added")
    else:
        key = context.input_optional("key")
        coins = thrown(len(gaussians), key_generator(key, parameters.seed))
        dither = generator_apart(key, "dither", parameters.seed)
        before, stop = gaussians, context.stop_if_requested
        gaussians = grained(before, method, cameras, parameters.level, coins, dither, stop)
        shown = level_shown(before, gaussians, method, cameras, parameters.level, context.log, stop)
        context.record(level_shown=round(shown, 3))
    write_container(context.output("container"), gaussians, method)
    context.record(device=describe_drawing(device))
