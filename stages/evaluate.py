"""`evaluate`: how faithful the cover and every message are, on views that were trained on and views that were not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
from pydantic import Field

from opencl.device import choose_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.comparisons import write_comparisons
from stages.analysis.fidelity import Perceptual
from stages.analysis.scoring import Scores, leakage_rows, score
from stages.hiding.method import module_of
from stages.hiding.storage import check_method, published_bytes, read_gaussians, read_method
from stages.imaging.lpips import load_lpips
from stages.imaging.lpips_weights import HOW_TO_INSTALL
from stages.imaging.metric_table import MetricRow, write_rows
from stages.scene.message_views import MessageViews, read_messages
from stages.scene.scene import Scene, read_scene

REFERENCE_METHOD = "plain"


class EvaluateParameters(Parameters):
    """What is measured."""

    method: str = Field("gs_hider", description="The container's method.")
    lpips: Literal["vgg", "alex", "none"] = Field("vgg", description="The network of LPIPS, measured on test views.")
    shown_train_views: int = Field(2, ge=0, description="How many training views are kept as pictures.")
    threads: int = Field(2, ge=1, description="Threads of torch.")


@stage(
    inputs={
        "container": Input("container or splats"),
        "cover": Input("scene"),
        "secret": Input("secret", optional=True),
        "messages": Input("views", many=True, optional=True),
        "reference": Input("splats", optional=True),
    },
    outputs={
        "scores": Output("metrics", privacy="private"),
        "public_scores": Output("metrics", privacy="public"),
        "pictures": Output("comparisons", privacy="private"),
        "public_pictures": Output("comparisons", privacy="public"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method), module_of(REFERENCE_METHOD)],
)
def evaluate(context: Context, parameters: EvaluateParameters) -> None:
    """Score the container's cover and messages, and beside them plain 3DGS of the same cover where it is given."""
    torch.set_num_threads(parameters.threads)
    scene = read_scene(context.input("cover"))
    messages = read_messages(context.input_many("messages"), scene.cameras.names)
    perceptual = _perceptual(parameters)
    container, reference = context.input("container"), context.input_optional("reference")
    secret = context.input_optional("secret")
    check_method(container, parameters.method)
    if messages and secret is None:
        raise UserError(
            "messages cannot be scored",
            found="messages without a secret",
            expected="the message decoder",
            remedy="give evaluate the input secret: hide.secret",
        )
    passes = 1 if reference is None else 2

    def scored(splats: Artifact, name: str, hidden: Mapping[str, MessageViews], finished: int) -> Scores:
        def progress(done: int, total: int) -> None:
            context.progress(finished * total + done, passes * total)
            context.stop_if_requested()

        method, gaussians = read_method(splats, secret if hidden else None), read_gaussians(splats)
        shown = parameters.shown_train_views
        scores = score(gaussians, method, name, scene, hidden, perceptual, shown, progress)
        # For the reference, which has never seen a message, this is the control: what chance gives.
        scores.rows += _sizes(splats, name) + leakage_rows(scores, messages)
        return scores

    every = [scored(container, parameters.method, messages, 0)]
    if reference is not None:
        every.append(scored(reference, REFERENCE_METHOD, {}, 1))
    _write(context, every, scene)
    context.record(device=choose_device().describe())


def _perceptual(parameters: EvaluateParameters) -> Perceptual:
    if parameters.lpips == "none":
        return {}
    metric = load_lpips(parameters.lpips)
    if metric is None:
        # Not left out silently: the result would be kept, and would still lack LPIPS once the weights are there.
        raise UserError(
            f"LPIPS ({parameters.lpips}) cannot be measured",
            found="no weights",
            remedy=f"{HOW_TO_INSTALL} Or leave it out: --set scores.lpips=none",
        )
    return {f"lpips_{parameters.lpips}": metric}


def _sizes(splats: Artifact, name: str) -> list[MetricRow]:
    return [
        MetricRow("container_bytes", published_bytes(splats), "bytes", method=name),
        MetricRow("gaussians", float(str(splats.attributes["gaussians"])), method=name),
    ]


def _write(context: Context, every: list[Scores], scene: Scene) -> None:
    """Everything for the owner; for the public, only what any holder of the container can render."""
    rows = [row for scores in every for row in scores.rows]
    pictures = [comparison for scores in every for comparison in scores.comparisons(scene)]
    write_rows(context.output("scores"), rows)
    write_comparisons(context.output("pictures"), pictures)
    write_rows(context.output("public_scores"), [row for row in rows if row.message is None])
    write_comparisons(
        context.output("public_pictures"), [comparison for comparison in pictures if comparison.role != "message"]
    )
