"""`render_views`: what anyone can render of a container from new cameras along the rig, as input of detectors."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.renders import collect_renders, write_renders
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.photographs import photographs
from stages.hiding.rendering import Rendering
from stages.hiding.storage import check_drawn, read_gaussians, read_method
from stages.scene.camera_path import camera_path
from stages.scene.scene import read_scene
from stages.training.threads import Threads


class RenderViewsParameters(Parameters):
    """How many pictures are rendered, and the camera path."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    views: int = Field(
        250, ge=1, le=5000, description="Number of pictures, evenly spaced on a smooth path along the training cameras."
    )
    feature_maps: int = Field(64, ge=0, description="Number of these, evenly spread, whose feature map is kept, too.")
    bends: int = Field(32, ge=3, description="Maximum number of bends in the path; more keep it closer to the cameras.")
    threads: Threads = 2


@stage(
    inputs={"container": Input("container or splats"), "cover": Input("scene")},
    outputs={"renders": Output("renders")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def render_views(context: Context, parameters: RenderViewsParameters) -> None:
    """Render the cover without the secret, in pictures with even sides.

    The cameras depend only on the cover, so renders of several containers of one cover show the same views.
    """
    torch.set_num_threads(parameters.threads)
    container, scene, device = context.input("container"), read_scene(context.input("cover")), working_device()
    check_drawn(container, parameters.method, context.input("cover"))
    rig = scene.training_cameras
    path = camera_path(rig, scene.points, parameters.views, parameters.bends)

    def told() -> Iterator[Rendering]:
        rendered = photographs(read_gaussians(container, device), read_method(container, device=device), path)
        for number, rendering in enumerate(rendered, start=1):
            yield rendering
            context.progress_or_stop(number, parameters.views)

    write_renders(
        context.output("renders"), collect_renders(parameters.method, path.names, told(), parameters.feature_maps)
    )
    context.record(device=describe_drawing(device))
