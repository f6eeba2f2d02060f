"""`render_path`: videos of a camera that flies along the cover's cameras: the cover, the messages, the feature map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import FEATURE_MAP_CHANNELS
from stages.analysis.videos import Video, VideoRole, write_videos
from stages.hiding.message_names import FEATURE_MAP, SIDE_BY_SIDE
from stages.hiding.method import module_of
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER, Rendering
from stages.hiding.storage import check_method, read_gaussians, read_method
from stages.imaging.panels import columns_of, side_by_side
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.imaging.video import encode_video, enlarged
from stages.scene.camera_path import Course, camera_path
from stages.scene.cameras import Cameras
from stages.scene.scene import Scene, read_scene


class RenderPathParameters(Parameters):
    """How the camera flies."""

    method: str = Field("gs_hider", description="The container's method.")
    frames: int = Field(48, ge=2, le=5000, description="Pictures in each video. All are held in memory at once.")
    seconds: float = Field(4.0, gt=0, description="How long each video takes.")
    bends: int = Field(16, ge=3, description="How many bends the path has at most: with fewer it is smoother.")
    course: Course = Field(
        "auto",
        description="Whether the path is closed, so that the video can go on at its beginning, or open; "
        "auto closes it where the cameras stand so closely that no part of it is far from them.",
    )
    threads: int = Field(2, ge=1, description="Threads of torch.")


@stage(
    inputs={"container": Input("container"), "cover": Input("scene"), "secret": Input("secret", optional=True)},
    outputs={"videos": Output("videos", privacy="private"), "public_videos": Output("videos", privacy="public")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def render_path(context: Context, parameters: RenderPathParameters) -> None:
    """All that the owner sees along a smooth path of the training cameras, by itself and side by side; for the public,
    the cover alone.
    """
    torch.set_num_threads(parameters.threads)
    container = context.input("container")
    check_method(container, parameters.method)
    device = working_device()
    gaussians = read_gaussians(container, device)
    method = read_method(container, context.input_optional("secret"), device)
    path = path_along(read_scene(context.input("cover")), parameters)
    filmed: dict[str, list[Picture]] = {}
    for number, rendering in enumerate(photographs(gaussians, method, path), start=1):
        for title, picture in panels_of(rendering).items():
            filmed.setdefault(title, []).append(enlarged(picture))
        context.progress(number, parameters.frames)
        context.stop_if_requested()
    videos = encoded(filmed, parameters, context)
    write_videos(context.output("videos"), videos)
    write_videos(context.output("public_videos"), [video for video in videos if video.role == "cover"])
    context.record(device=describe_drawing(device))


def path_along(scene: Scene, parameters: RenderPathParameters) -> Cameras:
    """The path along the training cameras, or along all where none was trained on."""
    cameras = scene.cameras.select(scene.train_names or scene.cameras.names)
    return camera_path(cameras, scene.points, parameters.frames, parameters.bends, parameters.course)


def panels_of(rendering: Rendering) -> dict[str, Picture]:
    """The cover, the messages and the feature map of one camera; a picture that no decoder made is no feature map."""
    panels = {title: tensor_to_picture(picture) for title, picture in rendering.pictures.items()}
    if rendering.feature_map.shape[-1] > len(FEATURE_MAP_CHANNELS):
        panels[FEATURE_MAP] = tensor_to_picture(rendering.feature_map[..., list(FEATURE_MAP_CHANNELS)])
    return panels


def encoded(filmed: Mapping[str, Sequence[Picture]], parameters: RenderPathParameters, context: Context) -> list[Video]:
    """A video of each title, and where there are several, one of them all, since a page cannot keep videos in step."""
    videos = []
    for title, pictures in filmed.items():
        role: VideoRole = "cover" if title == COVER else "feature_map" if title == FEATURE_MAP else "message"
        videos.append(_video(title, role, (title,), pictures, parameters))
        context.stop_if_requested()
    if len(filmed) > 1:
        together = [side_by_side(pictures) for pictures in zip(*filmed.values(), strict=True)]
        videos.append(_video(SIDE_BY_SIDE, "side_by_side", tuple(filmed), together, parameters))
    return videos


def _video(
    title: str, role: VideoRole, panels: tuple[str, ...], pictures: Sequence[Picture], parameters: RenderPathParameters
) -> Video:
    height, width, _ = pictures[0].shape
    webm = encode_video(pictures, parameters.frames / parameters.seconds)
    return Video(title, role, parameters.method, panels, columns_of(len(panels)), width, height, webm)
