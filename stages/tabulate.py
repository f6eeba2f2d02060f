"""`tabulate`: the scores of a batch on one page, a row for each of its items, failed ones included."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.batch.page import owner_page, public_page, write_page, write_table
from stages.analysis.batch.results import OWNER_FIGURES, PUBLIC_FIGURES, read_result
from stages.analysis.page.placed import read_placed

PAGE_FILE, TABLE_FILE = "report.html", "figures.csv"


class TabulateParameters(Parameters):
    """What may be told to everyone."""

    public_columns: tuple[str, ...] = Field(
        (), description="The columns of the batch that name a scene on the public page; without any, it has a number."
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
    """The owner's page and table tell everything; the public page is made of the public scores that were made.

    That something failed is not told to the public: it may be because of a message. `scenes` say how many of their
    photos were placed, in the rows that come from them.
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
