"""`report`: one page for the owner, with everything, and one for the public, made of public parts alone."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.page.material import owner_material, public_material
from stages.analysis.page.page import owner_page, public_page, write_page

REPORT_FILE = "report.html"
INPUTS = {
    "scores": Input("metrics", many=True, optional=True),
    "public_scores": Input("metrics", many=True, optional=True),
    "curves": Input("metrics", many=True, optional=True),
    "timings": Input("metrics", many=True, optional=True),
    "pictures": Input("comparisons", many=True, optional=True),
    "public_pictures": Input("comparisons", many=True, optional=True),
    "videos": Input("videos", many=True, optional=True),
    "public_videos": Input("videos", many=True, optional=True),
    "figures": Input("measurements", many=True, optional=True),
}
SCENES = Input("scene", many=True, optional=True, labelled=True)


class ReportParameters(Parameters):
    """What the pages show."""

    views: int = Field(6, ge=1, description="How many views of each set of pictures to show, test views first.")


@stage(
    inputs={**INPUTS, "scenes": SCENES},
    outputs={"owner": Output("report", privacy="private"), "public": Output("report", privacy="public")},
    version=1,
)
def report(context: Context, parameters: ReportParameters) -> None:
    """Each page is one HTML file, about the method whose scores come first; without any it shows what it is given.

    What is private goes to the owner's page only: the public one is made from nothing but public artifacts and the
    stages that lead to them. Of `scenes` the pages say how many photos were placed. `figures` are those of
    `recover`, by which the owner's page says whose container was found.
    """
    inputs = {name: context.input_many(name) for name in INPUTS}
    lineage, scenes = context.lineage(), context.items("scenes")
    owner = owner_page(
        owner_material(inputs, lineage, scenes), context.workflow_name, context.command, parameters.views
    )
    public = public_page(public_material(inputs, lineage, scenes), parameters.views)
    context.output("owner").write_file(REPORT_FILE, write_page(owner))
    context.output("public").write_file(REPORT_FILE, write_page(public))
