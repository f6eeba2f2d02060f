"""`reveal`: what the secret shows of a recovered container, compared with what it shows of the published one."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import write_comparisons
from stages.analysis.scoring import HiddenImage, score
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import read_container
from stages.hiding.storage import check_method
from stages.hiding.what_is_hidden import view_of_an_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import tensor_to_picture
from stages.scene.attributes import strings
from stages.scene.cameras import Cameras
from stages.scene.message_views import MessageViews
from stages.scene.scene import read_scene
from stages.training.threads import Threads


class RevealParameters(Parameters):
    """The method of the containers, and how many pictures are kept."""

    method: MethodName = Field("gs_hider", description="The method of both containers.")
    shown_train_views: int = Field(2, ge=0, description="Number of training views kept as pictures.")
    threads: Threads = 2


@stage(
    inputs={
        "container": Input("container"),
        "published": Input("container"),
        "secret": Input("secret"),
        "cover": Input("scene"),
    },
    outputs={
        "scores": Output("metrics", privacy="private"),
        "pictures": Output("comparisons", privacy="private"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def reveal(context: Context, parameters: RevealParameters) -> None:
    """Render cover and messages from the cover's cameras, and score them.

    The cover is scored against its photos, each message against what the secret shows of the published container, since
    the owner need not have the message's own pictures. An image is rendered in the view that hides it, the only one
    where it is defined. For a sealed container, messages leave out Gaussians that are not among the published ones; the
    cover shows all Gaussians. Raises `UserError` for a secret without messages.
    """
    torch.set_num_threads(parameters.threads)
    container, published, secret = (context.input(name) for name in ("container", "published", "secret"))
    for each in (container, published):
        check_method(each, parameters.method)
    _refuse_no_message(secret)
    scene, device = read_scene(context.input("cover")), working_device()
    view = view_of_an_image(secret, scene, "reveal")
    looked_at = scene.cameras if view is None else scene.cameras.select([view])

    def progress(done: int) -> None:
        context.progress_or_stop(done, len(looked_at) + len(scene.cameras))

    messages = _as_published(published, secret, looked_at, device, progress)
    scores = score(
        read_container(container, secret, device, published),
        parameters.method,
        scene,
        messages if view is None else {},
        {},
        parameters.shown_train_views,
        lambda done, _: progress(len(looked_at) + done),
        _image(messages, view) if view is not None else None,
    )
    write_rows(context.output("scores"), scores.rows)
    write_comparisons(context.output("pictures"), scores.comparisons(scene))
    context.record(device=describe_drawing(device))


def _refuse_no_message(secret: Artifact) -> None:
    if not strings(secret, "messages"):
        raise UserError(
            "there is no message to reveal",
            where=str(secret.path),
            found="a secret without messages",
            expected="the secret of a container that hides a message",
            remedy="give import_container the folder of the secret, which holds secret.json",
        )


def _image(messages: Mapping[str, MessageViews], view: str) -> HiddenImage:
    """The only message, as rendered in the one view that hides it."""
    [message] = messages.values()
    return HiddenImage(message.name, view, message.pictures[0])


def _as_published(
    published: Artifact, secret: Artifact, cameras: Cameras, device: torch.device, progress: Callable[[int], None]
) -> dict[str, MessageViews]:
    """What the secret shows of each message from these cameras; every pixel counts as covered."""
    read = read_container(published, secret, device)
    size = (len(cameras), cameras.height, cameras.width)
    shown = {name: np.empty((*size, 3), np.uint8) for name in strings(secret, "messages")}
    for row, rendering in enumerate(read.photographs(cameras)):
        for name, pictures in shown.items():
            pictures[row] = tensor_to_picture(rendering.pictures[name])
        progress(row + 1)
    everywhere = torch.ones(()).expand(size).numpy()  # a view of a single number
    no_points, no_colors = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    return {
        name: MessageViews(name, cameras.names, pictures, no_points, no_colors, everywhere)
        for name, pictures in shown.items()
    }
