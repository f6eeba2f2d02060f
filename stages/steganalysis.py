"""`steganalysis`: StegExpose's values for photos, for renders that hide something, and for renders that do not."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.measurements import Measurement, write_measurements
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS, stegexpose_rows
from stages.analysis.renders import read_renders
from stages.analysis.stored_views import Views
from stages.hiding.method_names import MethodName
from stages.scene.scene import read_scene


class SteganalysisParameters(Parameters):
    """The method's name in the measurements."""

    method: MethodName = Field("gs_hider", description="The hiding method to name in the rows.")


@stage(
    inputs={
        "cover": Input("scene"),
        "hidden": Input("renders"),
        "clean": Input("renders"),
        "clean_again": Input("renders", optional=True),
    },
    outputs={"measurements": Output("measurements", privacy="private")},
    version=1,
)
def steganalysis(context: Context, parameters: SteganalysisParameters) -> None:
    """A row for every StegExpose detector and picture. Photos are the scene's, undistorted, at training size."""
    scene = read_scene(context.input("cover"))
    classes: dict[str, tuple[Views, tuple[str, ...]]] = {PHOTOS: (scene.pictures, scene.cameras.names)}
    for condition, given in ((HIDDEN, "hidden"), (CLEAN, "clean"), (CLEAN_AGAIN, "clean_again")):
        artifact = context.input_optional(given)
        if artifact is not None:
            renders = read_renders(artifact)
            classes[condition] = renders.pictures, renders.view_names
    rows: list[Measurement] = []
    for number, (condition, (pictures, names)) in enumerate(classes.items(), start=1):
        rows += stegexpose_rows(pictures, names, condition, parameters.method)
        context.progress_or_stop(number, len(classes))
    write_measurements(context.output("measurements"), rows)
