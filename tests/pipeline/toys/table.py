"""Lists what its numbers are about, including those that failed."""

from __future__ import annotations

from pipeline.stage import Context, Input, Output, Parameters, stage


class TableParameters(Parameters):
    """No parameters."""


@stage(
    inputs={
        "numbers": Input("numbers", many=True, labelled=True),
        "others": Input("numbers", many=True, labelled=True, optional=True),
    },
    outputs={"page": Output("report")},
    version=1,
)
def table(context: Context, parameters: TableParameters) -> None:
    rows = []
    for item in (*context.items("numbers"), *context.items("others")):
        told = item.cause if item.artifact is None else f"sum {item.artifact.read('values').sum():g}"
        rows.append(f"{item.label} {dict(item.values)} {told}\n")
    context.output("page").write_file("rows.txt", "".join(rows))
