"""`compare_with_paper`: the paper's tables, with our figures beside its own."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.paper.drawing import drawing_file, write_drawing
from stages.analysis.paper.grid import write_csv
from stages.analysis.paper.markdown import write_markdown
from stages.analysis.paper.page import Table, owner_page, public_page, write_page
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Columns, read_study

PAGE_FILE, MARKDOWN_FILE, TABLE_FILE = "report.html", "tables.md", "figures.csv"


class CompareWithPaperParameters(Parameters):
    """Which tables are made, and which columns of the items name capture, method, seed and message."""

    tables: tuple[Table, ...] = Field(("fidelity",), description="The tables, in order.")
    capture_column: str = Field("capture", description="The column of the items that names the cover's capture.")
    method_column: str = Field("method", description="The column that names the method; if absent, the scores name it.")
    seed_column: str = Field(
        "seed", description="The column of the seed; items that differ only in the seed are pooled."
    )
    message_column: str = Field(
        "message", description="The column that names the hidden scene, which the paper's figures may be of, too."
    )
    public_captures: bool = Field(False, description="Whether the public page names the captures.")


@stage(
    inputs={
        "scores": Input("metrics", many=True, optional=True, labelled=True),
        "public_scores": Input("metrics", many=True, optional=True, labelled=True),
        "timings": Input("metrics", many=True, optional=True, labelled=True),
        "experiments": Input("measurements", many=True, optional=True, labelled=True),
    },
    outputs={"owner": Output("report", privacy="private"), "public": Output("report", privacy="public")},
    version=1,
)
def compare_with_paper(context: Context, parameters: CompareWithPaperParameters) -> None:
    """Write a page of our figures beside the paper's for the owner, and one of the scenes' figures for the public.

    The owner's page shows everything. The public page is made only from public scores and timings, and is not written
    if they yield no table. `experiments` are measurements under conditions, such as attacks; none of them is public.
    Both pages end with the digests of the artifacts that they were made from.

    Items state what they are about: the capture, the method, the seed, and whichever they vary of `lambda_message`,
    `feature_dim`, `layers`, `decoder_width`, `iterations`, `gaussians` and `sealed`.
    """
    columns = Columns(
        parameters.capture_column, parameters.method_column, parameters.seed_column, parameters.message_column
    )
    timings = context.items("timings")
    paper = read_published()
    study = read_study(context.items("scores"), timings, columns, paper.setup, context.items("experiments"))
    owner = owner_page(study, parameters.tables, paper, context.workflow_name, context.command)
    shown = [
        [item for item in items if item.artifact is not None and not item.artifact.private]
        for items in (context.items("public_scores"), timings)
    ]
    public_study = read_study(shown[0], shown[1], columns, paper.setup)
    public = public_page(public_study, study, parameters.public_captures)
    context.output("public").attributes["tables"] = len(public.grids)
    for name, page in [("owner", owner), *([("public", public)] if public.grids else [])]:
        context.output(name).write_file(PAGE_FILE, write_page(page))
        context.output(name).write_file(MARKDOWN_FILE, write_markdown(page))
        context.output(name).write_file(TABLE_FILE, write_csv(page.grids))
        for chapter in page.chapters:
            if chapter.charts:
                drawing = write_drawing(chapter.title, chapter.charts)
                context.output(name).write_file(drawing_file(chapter.title), drawing)
