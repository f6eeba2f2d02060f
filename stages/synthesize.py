"""`synthesize`: our ray-traced photos of a procedural scene; its true cameras come with them, only to check SfM."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from pipeline.companion import Said, work_together
from pipeline.stage import Context, Output, Parameters, stage
from stages.imaging.pictures import encode_png
from stages.scene.capture import Capture, KnownPoses, Lens, write_capture
from stages.tracing import photograph_process
from stages.tracing.photograph_process import SCENES, Job, read_picture_file
from stages.tracing.rig import orbit


class SynthesizeParameters(Parameters):
    """Which scene is photographed, and how."""

    scene: Literal["courtyard", "library", "reef", "workshop"] = Field(description="The built-in scene to photograph.")
    views: int = Field(48, ge=1, le=999, description="Number of photos, taken on one closed walk about the scene.")
    width: int = Field(512, ge=16, description="Width of each photo, in pixels.")
    height: int = Field(384, ge=16, description="Height of each photo, in pixels.")
    samples: Literal[1, 4, 9, 16] = Field(
        4, description="Rays per pixel, one in each cell of a regular grid; more reduce aliasing."
    )
    gloss: float = Field(1.0, ge=0, le=1, description="Scale factor of highlights and reflections.")
    seed: int = Field(0, ge=0, description="Random seed for textures, small displacements, the walk and the rays.")
    processes: int = Field(
        2, ge=1, description="Number of photos rendered in parallel; the pictures do not depend on it."
    )


@stage(
    inputs={},
    outputs={"capture": Output("capture")},
    version=1,
    modules=lambda parameters: [f"{SCENES}.{parameters.scene}"],
)
def synthesize(context: Context, parameters: SynthesizeParameters) -> None:
    """Photograph a built-in scene from a closed path around it; processes share the photos among them."""
    size = (parameters.width, parameters.height)
    poses, intrinsics = orbit(parameters.views, *size, parameters.seed)
    names = [f"{view:03d}.png" for view in range(parameters.views)]
    pictures: dict[str, bytes | Path] = {}

    def develop(said: Said) -> None:
        view: int = said["view"]
        pictures[names[view]] = encode_png(read_picture_file(context.scratch, view))
        context.progress(len(pictures), len(names))

    work_together(
        "ray tracing",
        photograph_process.__name__,
        write_jobs(parameters, context.scratch),
        develop,
        context.stop_if_requested,
    )
    capture = Capture(
        names=tuple(names),
        sizes=(size,) * len(names),
        focal_pixels=tuple(float(matrix[0, 0]) for matrix in intrinsics),
        ordered=True,
        poses=KnownPoses("synthetic", poses, tuple(Lens.pinhole(matrix, *size) for matrix in intrinsics)),
    )
    write_capture(context.output("capture"), capture, pictures.__getitem__)


def write_jobs(parameters: SynthesizeParameters, folder: Path) -> list[Path]:
    """Write a file for each of P processes with the views that it is to photograph: every P-th one."""
    common = parameters.model_dump(exclude={"processes"})
    count = min(parameters.processes, parameters.views)
    jobs = [folder / f"photos-{number}.json" for number in range(count)]
    for number, job in enumerate(jobs):
        Job(chosen=tuple(range(number, parameters.views, count)), **common).write(job)
    return jobs
