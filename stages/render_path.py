"""`render_path`: videos of a flight along the cover's cameras: the cover, the messages, the feature map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.feature_map import feature_map_picture
from stages.analysis.filming import encoded, film
from stages.analysis.videos import write_videos
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.message_names import FEATURE_MAP
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import read_container
from stages.hiding.rendering import Rendering
from stages.hiding.storage import check_method
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.camera_path import Course, camera_path
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene, read_scene
from stages.training.threads import Threads


class RenderPathParameters(Parameters):
    """The camera's path, and the length of the videos."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    frames: int = Field(
        48, ge=2, le=5000, description="Number of frames in each video; all are held in memory at once."
    )
    seconds: float = Field(4.0, gt=0, description="Duration of each video, in seconds.")
    bends: int = Field(16, ge=3, description="Maximum number of bends in the path; fewer make it smoother.")
    course: Course = Field(
        "auto",
        description="Whether the path is a closed loop, so that the video can repeat seamlessly, or open; "
        "auto closes it if no part of the loop would be far from a camera.",
    )
    threads: Threads = 2


@stage(
    inputs={
        "container": Input("container"),
        "cover": Input("scene"),
        "secret": Input("secret", optional=True),
        "published": Input("container", optional=True),
    },
    outputs={"videos": Output("videos", privacy="private"), "public_videos": Output("videos", privacy="public")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def render_path(context: Context, parameters: RenderPathParameters) -> None:
    """Film everything the owner sees along a smooth path of the training cameras, separately and side by side.

    A hidden image is left out, for only its own camera shows it. Public videos show only the cover; there are none if
    the container is private. `published` opens a sealed container that was found and recovered. Raises `UserError`
    if the videos would be too large to be held in memory.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input_optional("secret")
    check_method(container, parameters.method)
    device = working_device()
    read = read_container(container, secret, device, context.input_optional("published"))
    path = path_along(read_scene(context.input("cover")), parameters)
    shown = () if secret is not None and IMAGE_VIEW in secret.attributes else None

    def moments() -> Iterator[Mapping[str, Picture]]:
        for number, rendering in enumerate(read.photographs(path, shown), start=1):
            yield panels_of(read.gaussians, rendering)
            context.progress_or_stop(number, parameters.frames)

    filmed = film(moments(), parameters.frames, "Set fewer frames.")
    rate = parameters.frames / parameters.seconds
    videos = encoded(filmed, parameters.method, rate, context.stop_if_requested)
    write_videos(context.output("videos"), videos)
    public = [video for video in videos if video.role == "cover" and not container.private]
    write_videos(context.output("public_videos"), public)
    context.record(device=describe_drawing(device))


def path_along(scene: Scene, parameters: RenderPathParameters) -> Cameras:
    """The path along the training cameras, or along all cameras if there are none."""
    cameras = scene.training_cameras
    return camera_path(cameras, scene.points, parameters.frames, parameters.bends, parameters.course)


def panels_of(gaussians: Gaussians, rendering: Rendering) -> dict[str, Picture]:
    """Pictures from one camera by title: the cover, the messages and, with coupled features, the feature map."""
    panels = {title: tensor_to_picture(picture) for title, picture in rendering.pictures.items()}
    features = feature_map_picture(gaussians, rendering)
    if features is not None:
        panels[FEATURE_MAP] = tensor_to_picture(features)
    return panels
