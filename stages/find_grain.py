"""`find_grain`: which of some pictures were rendered from a container with a grain?"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.errors import Interrupted
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.kept import kept, name_on
from stages.analysis.measurements import KIND, Measurement, write_measurements
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.storage import check_drawn
from stages.hiding.watermark.reading import CERTAIN, GrainReader, is_colorless, owners_reader
from stages.imaging.pictures import Picture, read_picture
from stages.scene.capture import picture_path, read_capture
from stages.scene.scene import read_scene
from stages.scene.unreadable import unreadable_names
from stages.training.threads import Threads

SCORE, FOUND, UNREADABLE = "standard_score", "has_grain", "cannot_be_read"


class FindGrainParameters(Parameters):
    """The container's method, and the source of the grain's coins."""

    method: MethodName = Field("plain", description="The container's method; plain for splats of 3DGS.")
    grain_seed: int = Field(0, ge=0, description="The seed given to add_grain; used if there is no key.")
    threads: Threads = 1


@stage(
    inputs={
        "before": Input("container or splats"),
        "cover": Input("scene"),
        "pictures": Input("capture"),
        "key": Input("key", optional=True),
    },
    outputs={"scores": Output(KIND, privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def find_grain(context: Context, parameters: FindGrainParameters) -> None:
    """Look for the grain in each picture, using the container from before the grain and the key it was added with.

    Each picture gets two rows and a line in the log: its standard score, and whether that reaches `CERTAIN`. The score
    of a picture without the grain is chance: one in 1.6 million reaches `CERTAIN`, and one in 815,000 of pictures
    that are smaller than the scene's once frames are cut off, which get two tests (`GrainReader.score`). A picture that
    is no evidence has a score of 0 and a NaN for whether it has the grain: it has no colour, or shows nothing of the
    scene that could be recognised. An unreadable picture gets one row, which says so.

    Scores are cached as they are found, so that a run over thousands of pictures loses none of them if it is killed.
    Copies of a picture share one score.
    """
    torch.set_num_threads(parameters.threads)
    before = context.input("before")
    check_drawn(before, parameters.method, context.input("cover"))
    scene, key, device = read_scene(context.input("cover")), context.input_optional("key"), working_device()
    drawn_by = describe_drawing(device)

    @cache  # its landmarks take a while, and a resumed run may have all scores
    def reader() -> GrainReader:
        return owners_reader(before, scene, key, parameters.grain_seed, device, context.stop_if_requested)

    capture = context.input("pictures")
    names = read_capture(capture).names
    rows = []
    for done, name in enumerate(names):
        context.progress(done, len(names))
        if context.stop_requested():
            raise Interrupted(f"stopped before picture {done + 1} of {len(names)}")
        path = picture_path(capture, name)
        picture = read_picture(path)
        [row] = kept(context.scratch, name_on(drawn_by, path.read_bytes()), partial(_scored, reader, picture))
        score = row.value
        context.log(f"{name}: {_told(picture, score)}")
        for quantity, value in ((SCORE, score), (FOUND, float(score >= CERTAIN) if score else math.nan)):
            rows.append(Measurement(quantity, value, "picture", view=name, method=parameters.method))
    for name in unreadable_names(capture):
        context.log(f"{name}: inconclusive: the file cannot be read")
        rows.append(Measurement(UNREADABLE, 1.0, "picture", view=name, method=parameters.method))
    write_measurements(context.output("scores"), rows)
    context.record(device=drawn_by)


def _scored(reader: Callable[[], GrainReader], picture: Picture) -> list[Measurement]:
    return [Measurement(SCORE, reader().score(picture), "picture")]


def _told(picture: Picture, score: float) -> str:
    if is_colorless(picture):
        return "inconclusive: it has no colour, and the grain is in the colours only"
    if score >= CERTAIN:
        return f"has the grain (standard score {score:.1f})"
    return (
        f"no grain found (standard score {score:.1f})" if score else "inconclusive: nothing of the scene is recognised"
    )
