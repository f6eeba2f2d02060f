"""`import_found`: a container that was found somewhere, as a PLY that any program may have saved."""

from __future__ import annotations

import torch
from pydantic import Field

from pipeline.plain_text import listed
from pipeline.stage import Context, ExternalPath, Input, Output, Parameters, stage
from stages.hiding.found_files import read_found
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container
from stages.scene.gaussians import Gaussians


class ImportFoundParameters(Parameters):
    """Where the file is, and the published container's method."""

    place: ExternalPath = Field(
        description="The PLY that was found, or the folder that holds it; other files there are ignored. A compressed "
        "PLY or a .splat will not do: these keep no features."
    )
    method: MethodName = Field("gs_hider", description="The published container's method.")


@stage(
    inputs={"published": Input("container or splats")},
    outputs={"container": Output("container")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def import_found(context: Context, parameters: ImportFoundParameters) -> None:
    """Read the Gaussians by the column names of the published container; `recover` makes a container of them.

    The output has the published networks, and features with any number of channels: it is for `recover`, not for
    rendering.
    """
    published = context.input("published")
    check_method(published, parameters.method)
    originals = read_gaussians(published)
    shapes = {name: tuple(values.shape[1:]) for name, values in originals.parameters.items()}
    found = read_found(parameters.place, shapes)
    gaussians = Gaussians({name: torch.from_numpy(values) for name, values in found.attributes.items()})
    write_container(context.output("container"), gaussians, read_method(published))
    without = f"; {found.left_out} with values that no scene has are left out" if found.left_out else ""
    context.log(f"{len(gaussians)} Gaussians, of {len(originals)} that were published{without}")
    if found.renamed:
        context.log(f"no column has a feature's name; {listed(found.renamed)} are read as features")
    context.record(gaussians=len(gaussians), left_out=found.left_out)
