"""`render_hidden`: a message's splats rendered from the cover's cameras (the paper's dataset construction).

The paper leaves the message wherever it is in the cover's world (`placement: same_world`). By default, it is moved to
where the cameras see most of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.enlarging import enlarged
from stages.hiding.message_names import MessageName
from stages.hiding.method import Method
from stages.hiding.method_names import PLAIN, module_of
from stages.hiding.photographs import photographs
from stages.hiding.placing import place
from stages.hiding.placing_alone import Up, place_alone, visibility
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.imaging.pictures import tensor_to_picture
from stages.scene.alignment import cameras_in_message_world
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import LEGAL_COVERAGE, MessageViews, write_message_views
from stages.scene.scene import Scene, read_scene
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC, SH_BASE
from stages.scene.world_scale import scaled, world_scale_of
from stages.training.threads import Threads


class RenderHiddenParameters(Parameters):
    """The message's name, and how it is placed."""

    name: MessageName = Field(description="The message's name in the secret and in the tables.")
    placement: Literal["aligned", "same_world"] = Field(
        "aligned",
        description="aligned: where the cover's cameras see most of it. same_world: left in place, for splats in the "
        "cover's own world, such as an edited cover, or one trained elsewhere with the cover's poses.",
    )
    search_width: int = Field(
        48,
        ge=8,
        description="Picture width at which the candidates for alignment are scored: 24 from every view, or without "
        "the message's scene 96 to 192 from 12 views. On two CPU cores, each look at a million Gaussians takes 0.3 to "
        "0.5 s, hardly less at a smaller width; so each million takes 6 to 19 minutes without its scene, and with it "
        "7 to 12 seconds for each view of the cover.",
    )
    up: Up = Field(
        "auto",
        description="Up direction of splats given without the message's scene; auto: -y, or as in the cover.",
    )
    seed: int = Field(0, ge=0, description="Random seed for the order of the message's points.")
    threads: Threads = 1


@stage(
    inputs={"splats": Input("splats"), "message": Input("scene", optional=True), "cover": Input("scene")},
    outputs={"views": Output("views")},
    version=3,
    modules=lambda parameters: [module_of(PLAIN)],
    remarks="stages.scene.remarks:message_hardly_seen",
)
def render_hidden(context: Context, parameters: RenderHiddenParameters) -> None:
    """Place the message so that the cover's cameras see as much of it as possible, then render it from each of them.

    Without the message's scene, nothing tells where its photos were taken, so it is placed by its splats alone.
    """
    torch.set_num_threads(parameters.threads)
    splats = context.input("splats")
    device = working_device()
    gaussians, method = read_gaussians(splats, device), read_method(splats, device=device)
    cover = read_scene(context.input("cover"))
    gaussians, placed, factor = _placed(context, parameters, gaussians, cover)
    seen = cameras_in_message_world(cover.cameras, placed)
    pictures, coverage = photograph_message(gaussians, method, seen, context.stop_if_requested)
    points, colors = visible_points(gaussians, parameters.seed)
    points = placed.points(points.astype(np.float64)).astype(np.float32)
    views = MessageViews(parameters.name, seen.names, pictures, points, colors, coverage)
    write_message_views(context.output("views"), views)
    context.log(
        f"{int(views.legal.sum())} of {len(views.view_names)} views are legal (coverage {LEGAL_COVERAGE} or more)"
    )
    context.record(
        device=describe_drawing(device),
        legal_views=int(views.legal.sum()),
        scale=round(float(placed.scale * factor), 4),
        placement=parameters.placement,
    )


def _placed(
    context: Context, parameters: RenderHiddenParameters, gaussians: Gaussians, cover: Scene
) -> tuple[Gaussians, Similarity, float]:
    """The message in a world that is large enough, the map from there into the cover's, and the factor it grew by."""
    if parameters.placement == "same_world":
        gaussians, factor = _in_world_of(context.input("cover"), gaussians, context.input("splats"))
        return gaussians, Similarity.identity(), factor
    artifact, message, factor = context.input_optional("message"), None, 1.0
    if artifact is not None:
        gaussians, factor = _in_world_of(artifact, gaussians, context.input("splats"))
        message = read_scene(artifact)
    gaussians, message, growth = enlarged(gaussians, message)
    if growth != 1:
        context.log(
            f"the message's world is small: enlarged {growth:.3g} times, so that it is not clipped by the near plane"
        )

    if message is None:
        placed = place_alone(gaussians, cover, parameters.up, parameters.search_width, context.progress_or_stop)
    else:
        placed = place(gaussians, message, cover, parameters.search_width, context.progress_or_stop)
    return gaussians, placed, factor * growth


def _in_world_of(scene: Artifact, gaussians: Gaussians, splats: Artifact) -> tuple[Gaussians, float]:
    """The Gaussians of `splats` in the world of a scene with the same poses, and the factor by which they grew."""
    factor = world_scale_of(scene) / world_scale_of(splats)
    return gaussians if factor == 1 else scaled(gaussians, factor), factor


def visible_points(gaussians: Gaussians, seed: int) -> tuple[Float32[np.ndarray, "N 3"], UInt8[np.ndarray, "N 3"]]:
    """Centres and colours of 3DGS's Gaussians, shuffled so that any first few are a fair sample of what is seen.

    They are drawn with weights of opacity times width, without replacement (Efraimidis and Spirakis, 2006). Structure
    from motion finds sparse points where there is texture; these are wherever there is a surface.
    """
    weight = visibility(gaussians)
    order = np.argsort(np.random.default_rng(seed).exponential(size=len(weight)) / weight, kind="stable")
    colors = (gaussians[SH_BASE].detach() * CONSTANT_HARMONIC + 0.5).clamp(0, 1)
    means, shades = gaussians.means.detach(), (colors * 255).round().to(torch.uint8)
    return means.cpu().numpy()[order], shades.cpu().numpy()[order]


def photograph_message(
    gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None] = lambda: None
) -> tuple[UInt8[np.ndarray, "V H W 3"], Float32[np.ndarray, "V H W"]]:
    """The message's pictures over black, and its coverage, from each of V cameras; V = 0 is allowed."""
    size = (len(cameras), cameras.height, cameras.width)
    pictures, coverage = np.empty((*size, 3), np.uint8), np.empty(size, np.float32)
    for row, view in enumerate(photographs(gaussians, method, cameras)):
        pictures[row] = tensor_to_picture(view.pictures[COVER].clamp(0, 1))
        coverage[row] = view.alphas.cpu().numpy()
        after_each()
    return pictures, coverage
