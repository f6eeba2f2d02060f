"""`report`: a page for the owner, with everything, and one for the public, made only of public parts."""

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

    views: int = Field(6, ge=1, description="Number of views shown from each set of pictures, test views first.")


@stage(
    inputs={**INPUTS, "scenes": SCENES},
    outputs={"owner": Output("report", privacy="private"), "public": Output("report", privacy="public")},
    version=1,
)
def report(context: Context, parameters: ReportParameters) -> None:
    """Write two pages, each a single HTML file, about the method whose scores come first, if there are any.

    The owner's page alone has what is private: the public one is made only from public artifacts and the stages that
    lead to them. For `scenes`, the pages say how many photos were placed. `figures` are those of `recover`, from which
    the owner's page says whose container was found. Raises `UserError` if two of `scores` are of the same method, other
    than plain: `tabulate` makes a page of many containers.
    """
    inputs = {name: context.input_many(name) for name in INPUTS}
    lineage, scenes = context.lineage(), context.items("scenes")
    owner = owner_page(
        owner_material(inputs, lineage, scenes), context.workflow_name, context.command, parameters.views
    )
    public = public_page(public_material(inputs, lineage, scenes), parameters.views)
    context.output("owner").write_file(REPORT_FILE, write_page(owner))
    context.output("public").write_file(REPORT_FILE, write_page(public))
