"""`hold_out`: the split into training and test views that came with a capture, instead of every eighth view."""

from __future__ import annotations

from dataclasses import replace

from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.scene.attributes import strings
from stages.scene.scene import read_scene, write_scene

GIVEN = "test_names"


class HoldOutParameters(Parameters):
    """Nothing is left to choose."""


@stage(
    inputs={"scene": Input("scene"), "capture": Input("capture")},
    outputs={"scene": Output("scene")},
    version=1,
)
def hold_out(context: Context, parameters: HoldOutParameters) -> None:
    """Make test views of those that the capture's files of poses hold out, as far as they are in the scene."""
    artifact, capture = context.input("scene"), context.input("capture")
    scene = read_scene(artifact)
    if GIVEN not in capture.attributes:
        raise UserError(
            "the capture says nothing of test views",
            where=str(capture.path),
            expected="a transforms_test.json, or test_filenames in a transforms.json",
            remedy="Take the scene as it is: every eighth of its views is a test view.",
        )
    given = set(strings(capture, GIVEN))
    test_names = tuple(name for name in scene.cameras.names if name in given)
    if not test_names or len(test_names) == len(scene.cameras):
        raise UserError(
            "the capture's test views leave nothing to train on" if test_names else "no test view is in the scene",
            where=str(artifact.path),
            found=f"{len(test_names)} of {len(scene.cameras)} views",
            expected="some views for training and some for tests",
        )
    write_scene(context.output("scene"), replace(scene, test_names=test_names))
    context.output("scene").attributes |= {**artifact.attributes, GIVEN: [*test_names]}
    context.log(f"{len(test_names)} of {len(scene.cameras)} views are test views")
