"""`tabulate`: the scores of a batch on one page, with a row for each of its items, including failed ones."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.batch.page import owner_page, public_page, write_page, write_table
from stages.analysis.batch.results import OWNER_FIGURES, PUBLIC_FIGURES, read_result
from stages.analysis.page.placed import read_placed

PAGE_FILE, TABLE_FILE = "report.html", "figures.csv"


class TabulateParameters(Parameters):
    """What the public page may show."""

    public_columns: tuple[str, ...] = Field(
        (), description="Batch columns that name a scene on the public page; without any, scenes are numbered."
    )


@stage(
    inputs={
        "scores": Input("metrics", many=True, labelled=True),
        "public_scores": Input("metrics", many=True, optional=True, labelled=True),
        "scenes": Input("scene", many=True, optional=True, labelled=True),
    },
    outputs={"owner": Output("report", privacy="private"), "public": Output("report", privacy="public")},
    version=1,
)
def tabulate(context: Context, parameters: TabulateParameters) -> None:
    """Write the owner's page and table, which have everything, and a public page of those public scores that were made.

    Failures are not public, since a message may be their cause. `scenes` say how many of their photos were placed, in
    the rows made from them.
    """
    lineage = {record.name: record for record in context.lineage()}
    placed = read_placed(context.items("scenes"))
    results = [read_result(item, OWNER_FIGURES, lineage, placed) for item in context.items("scores")]
    page = owner_page(results, context.workflow_name)
    context.output("owner").write_file(PAGE_FILE, write_page(page))
    context.output("owner").write_file(TABLE_FILE, write_table(results, OWNER_FIGURES, page.names))
    public_items = [item for item in context.items("public_scores") if item.artifact and not item.artifact.private]
    public = public_page([read_result(item, PUBLIC_FIGURES, {}) for item in public_items], parameters.public_columns)
    context.output("public").write_file(PAGE_FILE, write_page(public))
