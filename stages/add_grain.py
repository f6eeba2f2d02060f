"""`add_grain`: a trained container whose renders carry a grain that its owner finds: RTWS in a way of ours."""

from __future__ import annotations

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import generator_apart, key_generator
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import refuse_sealed
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container
from stages.hiding.watermark.coins import thrown
from stages.hiding.watermark.grain import MEASURED_ON, grained
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import read_scene


class AddGrainParameters(Parameters):
    """How strong the grain is, and whose."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    level: float = Field(
        1.5,
        ge=0,
        description="Of the grain in renders: root mean square, in levels of 255. 0: none, the container stays as it "
        "is.",
    )
    seed: int = Field(
        0,
        ge=0,
        description="Of the coins that decide how each Gaussian changes, where there is no key. It is no secret.",
    )
    threads: int = Field(1, ge=1, description="Threads of torch: sums over pixels, and so the bits, depend on it.")


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
    """Change every Gaussian a little in colour, one way or the other; nothing is trained, no decoder changes.

    With the secret, the message is kept out of it: features change in a direction that its decoder does not look along.
    With a key, nobody else knows how the coins fell. The container from before is what the grain is read with: keep it,
    and publish the other. At a level of 0 nothing changes, to the bit.
    """
    torch.set_num_threads(parameters.threads)
    container = context.input("container")
    check_method(container, parameters.method)
    refuse_sealed(context.input_optional("secret"), "add_grain")
    device, scene = working_device(), read_scene(context.input("cover"))
    method = read_method(container, context.input_optional("secret"), device)
    cameras = scene.cameras.select(learnt_names(scene)[::MEASURED_ON])
    gaussians = read_gaussians(container, device)
    if parameters.level == 0:
        context.log("left as it is: it is to have no grain")
    else:
        key = context.input_optional("key")
        coins = thrown(len(gaussians), key_generator(key, parameters.seed))
        dither = generator_apart(key, "dither", parameters.seed)
        gaussians = grained(gaussians, method, cameras, parameters.level, coins, dither)
    write_container(context.output("container"), gaussians, method)
    context.record(device=describe_drawing(device))
