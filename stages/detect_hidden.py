"""`detect_hidden`: does a detector trained on other scenes distinguish renders of a container from clean ones?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.learned_detection import Classes, detection_rows
from stages.analysis.measurements import write_measurements
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN
from stages.analysis.renders import read_renders
from stages.hiding.method_names import MethodName
from stages.training.threads import Threads

INPUTS = {"hidden": HIDDEN, "clean": CLEAN, "clean_again": CLEAN_AGAIN}


class DetectHiddenParameters(Parameters):
    """Which capture is tested, and how the detector is trained."""

    capture: str = Field(
        "", description="The cover capture to test on; the detector is trained on the renders of all others."
    )
    method: MethodName = Field(
        "gs_hider", description="The hiding method; the detector is trained and tested on its renders only."
    )
    capture_column: str = Field("cover", description="The column of the items that names the cover's capture.")
    method_column: str = Field("method", description="The column that names the method that hides.")
    iterations: int = Field(300, ge=1, description="Training steps of the detector.")
    seed: int = Field(0, ge=0, description="Random seed for the detector's initial weights and its training crops.")
    threads: Threads = 1


@stage(
    inputs={name: Input("renders", many=True, labelled=True, optional=name == "clean_again") for name in INPUTS},
    outputs={"measurements": Output("measurements", privacy="private")},
    version=1,
)
def detect_hidden(context: Context, parameters: DetectHiddenParameters) -> None:
    """Train a detector on renders of all other captures, and score every render of the tested one.

    Hidden and clean renders belong together if their items are of the same row. If the capture has several rows, such
    as trainings with different seeds, the column `seed` numbers them from 0. There are no rows if the capture was not
    rendered. If no other capture was, there are no scores, and the rows only say that there was nothing to train on.
    """
    torch.set_num_threads(parameters.threads)
    rows = _rows_of(context, parameters)

    def progress(share: float) -> None:
        context.progress_or_stop(share, 1)

    measured = detection_rows(
        [_read(each, tuple(each)) for capture, each in rows if capture == parameters.capture],
        [(capture, _read(each, (HIDDEN, CLEAN))) for capture, each in rows if capture != parameters.capture],
        parameters.method,
        parameters.seed,
        parameters.iterations,
        progress,
        working_device(),
    )
    write_measurements(context.output("measurements"), measured)
    context.record(device=describe_drawing(working_device()))


def _rows_of(context: Context, parameters: DetectHiddenParameters) -> list[tuple[str, Mapping[str, Artifact]]]:
    """Capture and artifacts by class for each row of the method that has both hidden and clean renders."""
    found: dict[str, dict[str, Artifact]] = {}
    captures = {}
    for name, condition in INPUTS.items():
        for item in context.items(name):
            if item.artifact is not None and item.values.get(parameters.method_column) == parameters.method:
                found.setdefault(item.label, {})[condition] = item.artifact
                captures[item.label] = str(item.values.get(parameters.capture_column))
    return [(captures[label], each) for label, each in found.items() if HIDDEN in each and CLEAN in each]


def _read(artifacts: Mapping[str, Artifact], conditions: Sequence[str]) -> Classes:
    return {condition: read_renders(artifacts[condition]) for condition in conditions}
