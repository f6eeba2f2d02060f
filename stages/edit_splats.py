"""`edit_splats`: recolour a scene, remove or add an object, to make a message of the cover itself, as in the paper.

The paper's edits are by GaussianEditor, from words; these are by colour and by region.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.method import build_method
from stages.hiding.method_names import PLAIN, module_of
from stages.hiding.storage import check_method, read_gaussians, write_container
from stages.scene.alignment import rig_of
from stages.scene.editing import Splats, edited
from stages.scene.edits import Edit
from stages.scene.frames import rig_frame
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import degree_of
from stages.scene.scene import read_scene
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import SH_REST
from stages.scene.world_scale import stated, world_scale_of


class EditSplatsParameters(Parameters):
    """The edits to apply."""

    edits: list[Annotated[Edit, Field(discriminator="edit")]] = Field(
        description="List of edits (recolour, remove or add), applied in order.", min_length=1, max_length=100
    )


@stage(
    inputs={
        "splats": Input("splats"),
        "scene": Input("scene", optional=True),
        "added": Input("splats", optional=True),
        "added_scene": Input("scene", optional=True),
    },
    outputs={"splats": Output("splats")},
    version=1,
    modules=lambda parameters: [module_of(PLAIN)],
)
def edit_splats(context: Context, parameters: EditSplatsParameters) -> None:
    """Apply the edits in order.

    Rig coordinates are relative to the cameras of `scene`, on which the splats were trained; those of added splats, to
    the cameras of `added_scene` or else to their own extent. Raises `UserError` for rig coordinates without `scene`.
    """
    splats = _read(context.input("splats"), context.input_optional("scene"), "scene")
    given = context.input_optional("added")
    added = None if given is None else _read(given, context.input_optional("added_scene"), "added_scene")
    gaussians = splats.gaussians
    for number, edit in enumerate(parameters.edits, start=1):
        gaussians, count = edited(replace(splats, gaussians=gaussians), edit, added)
        context.log(f"edit {number}, {edit.edit}: {count} Gaussians")
        context.progress_or_stop(number, len(parameters.edits))
    _write(context, gaussians)
    context.output("splats").attributes.update(stated(world_scale_of(context.input("splats"))))
    context.record(gaussians=len(gaussians))


def _read(splats: Artifact, scene: Artifact | None, name: str) -> Splats:
    check_method(splats, PLAIN)
    scale, frame = world_scale_of(splats), None
    if scene is not None:
        photographed = read_scene(scene)
        of_scene = rig_frame(rig_of(photographed.cameras, photographed.points))
        frame = Similarity(scale / world_scale_of(scene), np.eye(3), np.zeros(3)).compose(of_scene)
    return Splats(read_gaussians(splats), frame, name, scale)


def _write(context: Context, gaussians: Gaussians) -> None:
    degree = degree_of(gaussians[SH_REST])
    write_container(context.output("splats"), gaussians, build_method(PLAIN, {"sh_degree": degree}))
