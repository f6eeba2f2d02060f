"""`import_splats`: Gaussians trained elsewhere, so that a scene can be a message without its photos."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.hiding.method import build_method
from stages.hiding.method_names import PLAIN, module_of
from stages.hiding.storage import write_container
from stages.scene.splat_files.reading import read_splats


class ImportSplatsParameters(Parameters):
    """Where the splats are."""

    file: ExternalPath = Field(
        description="Trained Gaussians: a PLY of 3DGS or Mip-Splatting, a compressed PLY of PlayCanvas, or a .splat "
        "file; detected by content."
    )


@stage(
    inputs={},
    outputs={"splats": Output("splats")},
    version=1,
    modules=lambda parameters: [module_of(PLAIN)],
)
def import_splats(context: Context, parameters: ImportSplatsParameters) -> None:
    """Read and check every Gaussian, and write them as `train_scene` would have."""
    gaussians, degree = read_splats(parameters.file)
    write_container(context.output("splats"), gaussians, build_method(PLAIN, {"sh_degree": degree}))
    context.log(f"{len(gaussians)} Gaussians with spherical harmonics of degree {degree}")
    context.record(gaussians=len(gaussians), sh_degree=degree)
