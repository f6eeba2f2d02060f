"""`export_splats`: splats as a PLY file of 3DGS, which ordinary viewers open."""

from __future__ import annotations

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.bundle import container_bundle, write_gaussians

SPLATS_FILE = "splats.ply"


class ExportSplatsParameters(Parameters):
    """Nothing is to be chosen."""


@stage(inputs={"splats": Input("splats")}, outputs={"bundle": Output("bundle")}, version=1)
def export_splats(context: Context, parameters: ExportSplatsParameters) -> None:
    """Write the splats with 3DGS's columns in 3DGS's order; those of a message stay private."""
    bundle = container_bundle(context.input("splats"))
    write_gaussians(context.output("bundle").path_for(SPLATS_FILE), bundle)
    context.record(gaussians=len(bundle.attributes["means"]))
