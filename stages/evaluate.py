"""`evaluate`: fidelity of the cover and of every message, on training views and on test views."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
from pydantic import Field, field_validator

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import Comparison, write_comparisons
from stages.analysis.public_scores import comparisons_for_the_public, rows_for_the_public
from stages.analysis.scoring import HiddenImage, Scores, leakage_rows, score, views_for_the_public
from stages.hiding.method_names import PLAIN, MethodName, module_of
from stages.hiding.opening import read_container
from stages.hiding.storage import bytes_of, check_drawn
from stages.hiding.what_is_hidden import messages_to_read, view_that_hides
from stages.imaging.image import filling, read_image
from stages.imaging.lpips import lpips_metrics
from stages.imaging.lpips_weights import Network, weights_installed
from stages.imaging.metric_table import MetricRow, write_rows
from stages.scene.message_views import MessageViews, read_messages
from stages.scene.scene import Scene, read_scene
from stages.training.threads import Threads

Networks = Literal["vgg", "alex", "both", "none"]
NETWORKS: Mapping[Networks, tuple[Network, ...]] = {
    "vgg": ("vgg",),
    "alex": ("alex",),
    "both": ("vgg", "alex"),
    "none": (),
}


class EvaluateParameters(Parameters):
    """What is measured.

    LPIPS is measured only with networks whose weights are installed; once they are, scores without it are computed
    again. It is not measured on pictures that are too small for a network's layers.
    """

    method: MethodName = Field("gs_hider", description="The container's method.")
    lpips: Networks = Field("vgg", description="Backbone network of LPIPS, which is measured on test views.")
    shown_train_views: int = Field(2, ge=0, description="Number of training views kept as pictures.")
    threads: Threads = 2

    @field_validator("lpips")
    @classmethod
    def _as_installed(cls, wanted: Networks) -> Networks:
        installed = tuple(network for network in NETWORKS[wanted] if weights_installed(network))
        return next(name for name, networks in NETWORKS.items() if networks == installed)


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "secret": Input("secret", optional=True),
        "messages": Input("views", many=True, optional=True),
        "image": Input("image", optional=True),
        "reference": Input("splats", optional=True),
    },
    outputs={
        "scores": Output("metrics", privacy="private"),
        "public_scores": Output("metrics", privacy="public"),
        "pictures": Output("comparisons", privacy="private"),
        "public_pictures": Output("comparisons", privacy="public"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method), module_of(PLAIN)],
)
def evaluate(context: Context, parameters: EvaluateParameters) -> None:
    """Score the container's cover and its messages or hidden image, and plain 3DGS of the cover if it is given.

    Public outputs are about the cover alone: private splats have none, and if the cover is private, neither its photos
    nor their names are shown. Raises `UserError` for messages or an image without the secret.
    """
    torch.set_num_threads(parameters.threads)
    device, scene = working_device(), read_scene(context.input("cover"))
    messages = read_messages(context.input_many("messages"), scene.cameras.names)
    rig = scene.cameras
    perceptual = lpips_metrics(NETWORKS[parameters.lpips], rig.width, rig.height, device, context.log)
    container, reference = context.input("container"), context.input_optional("reference")
    secret = context.input_optional("secret")
    check_drawn(container, parameters.method, context.input("cover"))
    if reference is not None:
        check_drawn(reference, PLAIN, context.input("cover"))
    messages = messages_to_read(messages, secret, "evaluate")
    image = _hidden_image(context.input_optional("image"), secret, scene)
    passes = 1 if reference is None else 2

    def scored(splats: Artifact, name: str, hidden: Mapping[str, MessageViews], finished: int) -> Scores:
        def progress(done: int, total: int) -> None:
            context.progress_or_stop(finished * total + done, passes * total)

        own = splats is container
        decodes = own and bool(messages or image)
        read = read_container(splats, secret if decodes else None, device)
        shown = parameters.shown_train_views
        hides = image if own else None
        scores = score(read, name, scene, hidden, perceptual, shown, progress, hides, keep_residuals=bool(messages))
        # For the reference, which never saw a message, this is the control: the correlation due to chance.
        scores.rows += _sizes(splats, name, secret if own else None) + leakage_rows(scores, messages)
        scores.residuals.clear()  # as large as all test views in float32, and no longer needed
        return scores

    every = [scored(container, parameters.method, messages, 0)]
    published = [] if container.private else [*every]
    if reference is not None:
        every.append(scored(reference, PLAIN, {}, 1))
        published += [] if reference.private else every[-1:]
    _write(context, every, scene, published, views_for_the_public(scene, parameters.shown_train_views))
    context.record(device=describe_drawing(device))


def _hidden_image(image: Artifact | None, secret: Artifact | None, scene: Scene) -> HiddenImage | None:
    if image is None:
        return None
    name, picture = read_image(image)
    view = view_that_hides(name, secret, scene, "evaluate")
    return HiddenImage(name, view, filling(picture, scene.cameras.width, scene.cameras.height))


def _sizes(splats: Artifact, name: str, secret: Artifact | None) -> list[MetricRow]:
    published = bytes_of(splats)
    return [
        MetricRow("container_bytes", published, "bytes", method=name),
        MetricRow("total_bytes", published + (bytes_of(secret) if secret is not None else 0), "bytes", method=name),
        MetricRow("gaussians", float(str(splats.attributes["gaussians"])), method=name),
    ]


def _write(
    context: Context, every: list[Scores], scene: Scene, published: list[Scores], public_views: set[str]
) -> None:
    """Write everything for the owner, and what is `published` for the public (see `stages.analysis.public_scores`)."""
    private_cover = context.input("cover").private
    write_rows(context.output("scores"), _rows(every))
    write_comparisons(context.output("pictures"), _comparisons(every, scene))
    write_rows(context.output("public_scores"), rows_for_the_public(_rows(published), private_cover))
    shown = comparisons_for_the_public(_comparisons(published, scene), public_views, private_cover)
    write_comparisons(context.output("public_pictures"), shown)


def _rows(every: list[Scores]) -> list[MetricRow]:
    return [row for scores in every for row in scores.rows]


def _comparisons(every: list[Scores], scene: Scene) -> list[Comparison]:
    return [comparison for scores in every for comparison in scores.comparisons(scene)]
