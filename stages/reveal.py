"""`reveal`: what the secret reads of a container that was recovered, beside what it reads of the published one."""

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
from stages.hiding.photographs import photographs
from stages.hiding.storage import check_method, read_gaussians, read_method
from stages.hiding.what_is_hidden import view_of_an_image
from stages.imaging.metric_table import write_rows
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.attributes import strings
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene, read_scene


class RevealParameters(Parameters):
    """Whose container it is, and what is kept."""

    method: MethodName = Field("gs_hider", description="The method of both containers.")
    shown_train_views: int = Field(2, ge=0, description="How many training views are kept as pictures.")
    threads: int = Field(2, ge=1, description="Threads of torch.")


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
    """Render cover and messages from the cover's cameras: the cover is scored against its photos, and each message
    against what the secret shows of the published container, for the message's own pictures the owner need not have.
    An image is looked at in the view that hides it, where alone it is defined.
    """
    torch.set_num_threads(parameters.threads)
    container, published, secret = (context.input(name) for name in ("container", "published", "secret"))
    for each in (container, published):
        check_method(each, parameters.method)
    if not strings(secret, "messages"):
        raise UserError(
            "nothing can be revealed",
            where=str(secret.path),
            found="a secret of no message",
            expected="that of a container that hides something",
            remedy="give import_container the folder of the secret, which holds secret.json",
        )
    scene = read_scene(context.input("cover"))
    views = len(scene.cameras)
    view = view_of_an_image(secret, scene, "reveal")

    def progress(done: int, before: int) -> None:
        context.progress(before + done, 2 * views)
        context.stop_if_requested()

    device = working_device()
    messages = _as_published(published, secret, scene, device, lambda done: progress(done, 0))
    image = _image_as_published(messages, view) if view is not None else None
    scores = score(
        read_gaussians(container, device),
        read_method(container, secret, device),
        parameters.method,
        scene,
        messages if image is None else {},
        {},
        parameters.shown_train_views,
        lambda done, _: progress(done, views),
        image,
    )
    write_rows(context.output("scores"), scores.rows)
    write_comparisons(context.output("pictures"), scores.comparisons(scene))
    context.record(device=describe_drawing(device))


def _image_as_published(messages: Mapping[str, MessageViews], view: str) -> HiddenImage:
    [image] = messages.values()
    return HiddenImage(image.name, view, image.pictures[image.view_names.index(view)])


def _as_published(
    published: Artifact, secret: Artifact, scene: Scene, device: torch.device, progress: Callable[[int], None]
) -> dict[str, MessageViews]:
    """What the secret shows of each message in every view of the cover, all of every picture counting."""
    gaussians, method = read_gaussians(published, device), read_method(published, secret, device)
    names = strings(secret, "messages")
    shown: dict[str, list[Picture]] = {name: [] for name in names}
    for done, rendering in enumerate(photographs(gaussians, method, scene.cameras), start=1):
        for name in names:
            shown[name].append(tensor_to_picture(rendering.pictures[name]))
        progress(done)
    everywhere = np.ones(scene.pictures.shape[:3], np.float32)
    nowhere = np.empty((0, 3))
    return {
        name: MessageViews(
            name,
            scene.cameras.names,
            np.stack(pictures),
            nowhere.astype(np.float32),
            nowhere.astype(np.uint8),
            everywhere,
        )
        for name, pictures in shown.items()
    }
