"""`export_splats`: splats as a PLY file of 3DGS, which ordinary viewers open."""

from __future__ import annotations

from dataclasses import replace

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.bundle import container_bundle, write_gaussians
from stages.hiding.storage import read_gaussians
from stages.scene.world_scale import scaled, world_scale_of

SPLATS_FILE = "splats.ply"


class ExportSplatsParameters(Parameters):
    """There are no parameters."""


@stage(inputs={"splats": Input("splats")}, outputs={"bundle": Output("bundle")}, version=1)
def export_splats(context: Context, parameters: ExportSplatsParameters) -> None:
    """Write the splats with 3DGS's columns in 3DGS's order; those of a private message stay private.

    Positions are in the world of the poses that came with the photos, even if the scene was enlarged for training.
    """
    splats = context.input("splats")
    bundle, scale = container_bundle(splats), world_scale_of(splats)
    if scale != 1:
        smaller = scaled(read_gaussians(splats), 1 / scale)
        moved = {name: smaller[name].numpy() for name in ("means", "log_scales")}
        bundle = replace(bundle, attributes={**bundle.attributes, **moved})
    write_gaussians(context.output("bundle").path_for(SPLATS_FILE), bundle)
    context.record(gaussians=len(bundle.attributes["means"]))
