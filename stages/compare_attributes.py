"""`compare_attributes`: do a container's Gaussians differ in their attributes from those of one that hides nothing?"""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.attribute_histograms import compare_attributes as compared
from stages.analysis.attribute_histograms import histogram_rows
from stages.analysis.measurements import write_measurements
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN
from stages.hiding.method_names import MethodName
from stages.hiding.stored_arrays import attributes_of


class CompareAttributesParameters(Parameters):
    """The method's name in the measurements."""

    method: MethodName = Field("gs_hider", description="The hiding method to name in the rows.")


@stage(
    inputs={
        "hidden": Input("container or splats"),
        "clean": Input("container or splats"),
        "clean_again": Input("container or splats", optional=True),
    },
    outputs={"measurements": Output("measurements", privacy="private")},
    version=1,
)
def compare_attributes(context: Context, parameters: CompareAttributesParameters) -> None:
    """Measure how far histograms of the container's attributes diverge from those of a clean one.

    `clean_again`, trained like `clean` but with another seed, is the control: its rows say how far two clean trainings
    differ. The histograms are among the rows as well.
    """
    clean = attributes_of(context.input("clean"))
    others = {HIDDEN: attributes_of(context.input("hidden"))}
    again = context.input_optional("clean_again")
    if again is not None:
        others[CLEAN_AGAIN] = attributes_of(again)
    rows = [row for name, own in others.items() for row in compared(own, clean, name, parameters.method)]
    rows += histogram_rows({HIDDEN: others[HIDDEN], CLEAN: clean} | others, parameters.method)
    write_measurements(context.output("measurements"), rows)
