"""`view_container`: what a container's files show: the cover and, to those with the secret, the messages beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import Comparison, Role, write_comparisons
from stages.analysis.filming import encoded, film
from stages.analysis.videos import write_videos
from stages.hiding.bundle import CAMERAS, IMAGE_CAMERA
from stages.hiding.camera_files import MOST_CAMERAS
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import read_container
from stages.hiding.rendering import COVER
from stages.hiding.storage import check_method
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.alignment import sample
from stages.scene.cameras import Cameras
from stages.scene.stored_cameras import read_cameras
from stages.training.threads import Threads


class ViewContainerParameters(Parameters):
    """Number and size of videos and pictures."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    frames: int = Field(
        96,
        ge=2,
        le=MOST_CAMERAS,
        description="Number of video frames, evenly spread over the published cameras; all are held in memory.",
    )
    seconds: float = Field(8.0, gt=0, description="Duration of each video, in seconds.")
    pictures: int = Field(6, ge=1, description="Number of frames also kept as pictures.")
    width: int = Field(800, ge=16, description="Maximum long side of pictures, in pixels; larger ones are shrunk.")
    threads: Threads = 2


@stage(
    inputs={
        "container": Input("container"),
        "cameras": Input("cameras"),
        "secret": Input("secret", optional=True),
        "image_camera": Input("cameras", optional=True),
    },
    outputs={
        "videos": Output("videos", privacy="private"),
        "public_videos": Output("videos", privacy="public"),
        "pictures": Output("comparisons", privacy="private"),
        "public_pictures": Output("comparisons", privacy="public"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def view_container(context: Context, parameters: ViewContainerParameters) -> None:
    """Render the cover, and each message beside it, along the published cameras.

    An image hidden in one view is rendered only from there: from elsewhere, its decoder shows nothing of it. Raises
    `UserError` if the bundles lack the cameras for this, and if the videos would be too large to be held in memory.
    """
    torch.set_num_threads(parameters.threads)
    container, secret = context.input("container"), context.input_optional("secret")
    check_method(container, parameters.method)
    path = _path(context.input("cameras"), parameters)
    hiding = _image_camera(context.input_optional("image_camera"), secret, parameters)
    device = working_device()
    read = read_container(container, secret, device)

    def moments() -> Iterator[Mapping[str, Picture]]:
        for number, rendering in enumerate(read.photographs(path, None if hiding is None else ()), start=1):
            yield {title: tensor_to_picture(picture) for title, picture in rendering.pictures.items()}
            context.progress_or_stop(number, len(path))

    filmed = film(moments(), len(path), "Set fewer frames, or a smaller width.")
    kept = _kept(filmed, path, parameters)
    if hiding is not None:
        shown = next(read.photographs(hiding)).pictures
        hidden = {title: [tensor_to_picture(picture)] for title, picture in shown.items() if title != COVER}
        kept += _kept(hidden, hiding, parameters)
    _write(context, parameters, filmed, kept)
    context.record(device=describe_drawing(device))


def _path(artifact: Artifact, parameters: ViewContainerParameters) -> Cameras:
    """Cameras of the video's frames, with even sides. Raises `UserError` if the bundle has none."""
    cameras = read_cameras(artifact)
    if cameras is None:
        raise UserError(
            "there are no cameras to view the container from",
            found=f"a bundle without {CAMERAS}",
            expected="the folder as export_container writes it when it is given the cover",
            remedy=f"ask whoever published it for {CAMERAS}, and put it into the folder beside the container",
        )
    frames = cameras.select([cameras.names[row] for row in sample(len(cameras), parameters.frames)])
    shown = _shrunk(frames, parameters.width)
    return replace(shown, width=shown.width + shown.width % 2, height=shown.height + shown.height % 2)


def _image_camera(
    artifact: Artifact | None, secret: Artifact | None, parameters: ViewContainerParameters
) -> Cameras | None:
    """The camera from which the secret shows an image; None without a secret, and for a secret of scenes."""
    if secret is None or IMAGE_VIEW not in secret.attributes:
        return None
    cameras = read_cameras(artifact) if artifact else None
    if cameras is None:
        raise UserError(
            "there is no camera to view the secret from",
            found=f"a secret without {IMAGE_CAMERA}",
            expected="the folder as export_container writes it when it is given the cover",
            remedy=f"ask whoever gave you the secret for {IMAGE_CAMERA}, and put it beside secret.json; without the "
            "secret, only the cover is shown",
        )
    return _shrunk(cameras, parameters.width)


def _shrunk(cameras: Cameras, long_side: int) -> Cameras:
    """The same views in pictures whose long side is at most `long_side` pixels."""
    factor = long_side / max(cameras.width, cameras.height)
    if factor >= 1:
        return cameras
    return cameras.resized(*(max(1, round(factor * side)) for side in (cameras.width, cameras.height)))


def _kept(
    filmed: Mapping[str, Sequence[Picture]], cameras: Cameras, parameters: ViewContainerParameters
) -> list[Comparison]:
    """Pictures of each title from a few evenly spread cameras."""
    rows = sample(len(cameras), parameters.pictures)
    names = tuple(cameras.names[row] for row in rows)
    comparisons = []
    for title, pictures in filmed.items():
        kept = np.stack([pictures[row] for row in rows])
        role: Role = "cover" if title == COVER else "message"
        comparisons.append(
            Comparison(title, role, parameters.method, names, ("",) * len(rows), kept, kept, has_truth=False)
        )
    return comparisons


def _write(
    context: Context,
    parameters: ViewContainerParameters,
    filmed: Mapping[str, Sequence[Picture]],
    pictures: Sequence[Comparison],
) -> None:
    """Write everything for whoever runs it, and for the public the cover alone, unless the container is private."""
    rate = len(filmed[COVER]) / parameters.seconds
    videos = encoded(filmed, parameters.method, rate, context.stop_if_requested)
    write_videos(context.output("videos"), videos)
    public = () if context.input("container").private else ("cover",)
    write_videos(context.output("public_videos"), [video for video in videos if video.role in public])
    write_comparisons(context.output("pictures"), pictures)
    write_comparisons(context.output("public_pictures"), [each for each in pictures if each.role in public])
