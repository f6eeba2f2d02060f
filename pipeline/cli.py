"""The command line: `python -m pipeline run | status | explain | graph | show | export | verify | gc | pin`.

Each command imports what it works with when it is called: help and the completion of the shell, which a person waits
for, load neither the engine nor any library of numbers.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands_results import export, show
from pipeline.commands_store import gc, pin, pins, unpin, verify
from pipeline.completion import complete_stage
from pipeline.console import (
    Json,
    Package,
    Settings,
    StageNames,
    StoreFolder,
    WorkflowFile,
    command_line,
    near,
    reported,
    say,
)
from pipeline.process import set_thread_policy

if TYPE_CHECKING:
    from pipeline.events import Summary
    from pipeline.executor import Executor
    from pipeline.graph import Graph
    from pipeline.project import Project

COMMAND = "gs-hider"  # the same program under a name of its own, which is what a shell can complete

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="""Runs workflows of stages, keeps every result, and repeats only what changed.

    \b
    python -m pipeline run workflows/hide_multi.yaml                  do it, or what is missing of it
    python -m pipeline status workflows/hide_multi.yaml               what is done, and what would run
    python -m pipeline explain workflows/hide_multi.yaml hide         why a stage would run
    python -m pipeline show hide_multi/hide.container                 what came out, and how it was made
    python -m pipeline show hide_multi/cover.scene --pictures seen    its pictures as PNG files
    python -m pipeline gc --dry-run                                   what nobody needs any more

    `COMMAND --help` shows more. The same program is called gs-hider: `gs-hider --install-completion` teaches your shell
    to complete workflows, stages, settings and results.
    """,
    context_settings={"max_content_width": 120},
)


def main() -> None:
    set_thread_policy()
    by_name = Path(sys.argv[0]).name == COMMAND or any(word.endswith("-completion") for word in sys.argv[1:2])
    app(prog_name=COMMAND if by_name else "python -m pipeline")


@app.command()
def run(
    workflow: WorkflowFile,
    stages: StageNames = None,
    settings: Settings = None,
    store: StoreFolder = Path("store"),
    workers: Annotated[int, typer.Option("--workers", min=1, metavar="N", help="Stages at the same time.")] = min(
        2, os.cpu_count() or 1
    ),
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="A dask scheduler that runs already.")
    ] = None,
    serial: Annotated[bool, typer.Option("--serial", help="One stage at a time in this process.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only says what would be done, and why.")] = False,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Runs a workflow: what is in the store is taken from there, the rest is done.

    \b
    python -m pipeline run workflows/hide_multi.yaml
    python -m pipeline run workflows/hide_multi.yaml --set iterations=300 --set hide.lambda_message=1.0
    python -m pipeline run workflows/hide_photos.yaml --set cover=photos/kitchen --set message=photos/fox
    python -m pipeline run workflows/hide_multi.yaml cover --dry-run

    Exit status: 0 done, 1 a stage failed, 2 the command or the workflow is wrong, 130 interrupted.
    """
    with reported():
        from pipeline.plan import make_plan
        from pipeline.planwords import print_plan
        from pipeline.project import open_project

        project = open_project(workflow, store, settings or [], package)
        graph = project.graph.needed_for(stages) if stages else project.graph
        if dry_run:
            print_plan(make_plan(graph, project.store), as_json)
            return
        summary = _run(project, graph, _executor_maker(workers, scheduler, serial), not serial, as_json)
        if summary.interrupted:
            say(f"Interrupted; what is done is kept. To go on: {command_line()}")
            raise typer.Exit(130)
        if summary.counts.get("failed"):
            say(f"What is done is kept. After a repair, go on with: {command_line()}")
            raise typer.Exit(1)


@app.command()
def status(
    workflow: WorkflowFile,
    settings: Settings = None,
    store: StoreFolder = Path("store"),
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Says of every stage whether its result is in the store, and if not, why.

    \b
    python -m pipeline status workflows/hide_multi.yaml
    """
    with reported():
        from pipeline.plan import make_plan
        from pipeline.planwords import print_plan
        from pipeline.project import open_project

        project = open_project(workflow, store, settings or [], package)
        print_plan(make_plan(project.graph, project.store), as_json)


@app.command()
def explain(
    workflow: WorkflowFile,
    stage: Annotated[
        str,
        typer.Argument(
            metavar="STAGE", help="A stage of the workflow.", show_default=False, autocompletion=complete_stage
        ),
    ],
    settings: Settings = None,
    store: StoreFolder = Path("store"),
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Says why a stage would run again, or what its result was made of.

    \b
    python -m pipeline explain workflows/hide_multi.yaml hide --set hide.lambda_message=1.0
    """
    with reported():
        from pipeline.plan import make_plan
        from pipeline.planwords import explained, print_plan
        from pipeline.project import open_project

        project = open_project(workflow, store, settings or [], package)
        steps = make_plan(project.graph.needed_for([stage]), project.store)
        wanted = {name: step for name, step in steps.items() if stage in (name, name.partition("[")[0])}
        if as_json:
            print_plan(wanted, as_json)
            return
        for step in wanted.values():
            print("\n".join(explained(step, project.store)))


@app.command()
def graph(
    workflow: WorkflowFile,
    settings: Settings = None,
    store: StoreFolder = Path("store"),
    svg: Annotated[
        Path | None, typer.Option("--svg", metavar="FILE", help="Draws the graph into a file.", show_default=False)
    ] = None,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Shows the stages of a workflow and what each takes from which.

    \b
    python -m pipeline graph workflows/hide_multi.yaml --svg hide_multi.svg
    """
    with reported():
        from pipeline.drawing import draw
        from pipeline.plan import make_plan
        from pipeline.planwords import box, node_as_json
        from pipeline.project import open_project

        project = open_project(workflow, store, settings or [], package)
        nodes = project.graph.nodes.values()
        if svg:
            steps = make_plan(project.graph, project.store)
            svg.write_text(draw([box(node, steps[node.name]) for node in nodes]))
            say(f"Drawn into {svg}")
            return
        width = max((len(node.name) for node in nodes), default=0)
        for node in nodes:
            if as_json:
                print(json.dumps(node_as_json(node)))
            else:
                takes = f"  ← {', '.join(node.upstream)}" if node.upstream else ""
                print(f"{node.name:{width}}  {node.uses}{' (private)' if node.private else ''}{takes}")


def _run(
    project: Project, graph: Graph, make_executor: Callable[[], Executor], captures: bool, as_json: bool
) -> Summary:
    from pipeline.progress import make_display, summary_words
    from pipeline.runner import Run

    display = make_display(graph.workflow, len(graph.nodes), json=as_json)
    with display:
        work = Run(
            graph, project.store, project.package, project.package_folder, make_executor, captures, display.__call__
        )
        summary = work.run()
    if not as_json:
        say(summary_words(graph.workflow, summary))
        for path in work.reports():
            print(f"Open {near(path)}")
        print(f"The store is {near(project.store.root)}")
    return summary


def _executor_maker(workers: int, scheduler: str | None, serial: bool) -> Callable[[], Executor]:
    def make() -> Executor:
        if serial:
            from pipeline.executor import SerialExecutor

            return SerialExecutor()
        from pipeline.cluster import DaskExecutor  # dask takes a second to import, which a cached run can do without

        return DaskExecutor(workers, scheduler)

    return make


for command in (show, export, verify, gc, pin, unpin, pins):
    app.command()(command)
