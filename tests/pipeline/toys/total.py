"""Adds up all numbers, and lists the stages that they were made by."""

from __future__ import annotations

import numpy as np

from pipeline.stage import Context, Input, Output, Parameters, stage


class TotalParameters(Parameters):
    """No parameters."""


@stage(
    inputs={"numbers": Input("numbers", many=True), "weights": Input("weights", optional=True)},
    outputs={"total": Output("numbers"), "page": Output("report", privacy="public"), "key": Output("key", "private")},
    version=1,
)
def total(context: Context, parameters: TotalParameters) -> None:
    sums = [artifact.read("values").sum() for artifact in context.input_many("numbers")]
    context.output("total").write("values", np.array(sums))
    context.output("key").write("values", np.array([sum(sums)]))
    rows = "".join(f"<li>{record.name} {record.uses} {list(record.inputs)}</li>" for record in context.lineage())
    context.output("page").write_file("report.html", f"<ul>{rows}</ul>")
