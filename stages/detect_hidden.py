"""`detect_hidden`: does a detector trained on other scenes distinguish renders of a container from clean ones?"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Item, Output, Parameters, stage
from stages.analysis.learned_detection import Classes, detection_rows
from stages.analysis.measurements import write_measurements
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN
from stages.analysis.renders import read_renders
from stages.hiding.method_names import MethodName
from stages.training.threads import Threads

MESSAGE_COLUMN = "message"
"""The column that names what a row hides."""

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

    Raises `UserError` if rows of the method and one capture differ in more than seeds and messages: they would be
    variants, which one detector would mix.
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
    items = {}
    for name, condition in INPUTS.items():
        for item in context.items(name):
            if item.artifact is not None and item.values.get(parameters.method_column) == parameters.method:
                found.setdefault(item.label, {})[condition] = item.artifact
                items[item.label] = item
    captures = {label: str(item.values.get(parameters.capture_column)) for label, item in items.items()}
    _refuse_variants(items.values(), captures, parameters.method)
    return [(captures[label], each) for label, each in found.items() if HIDDEN in each and CLEAN in each]


def _refuse_variants(items: Iterable[Item], captures: Mapping[str, str], method: str) -> None:
    first: dict[str, Item] = {}
    for item in items:
        capture = captures[item.label]
        other = first.setdefault(capture, item)
        columns = [
            name
            for name in dict.fromkeys([*other.values, *item.values])
            if other.values.get(name) != item.values.get(name) and name != MESSAGE_COLUMN and "seed" not in name
        ]
        if columns:
            raise UserError(
                f"the rows of {method} are of several variants, which one detector would mix",
                where=f"the rows {other.label} and {item.label}",
                found=f"different {' and '.join(columns)}",
                expected=f"rows of {method} on {capture} that differ only in messages and seeds",
                remedy="give each variant a run of its own, with its rows alone",
            )


def _read(artifacts: Mapping[str, Artifact], conditions: Sequence[str]) -> Classes:
    return {condition: read_renders(artifacts[condition]) for condition in conditions}
