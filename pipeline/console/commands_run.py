"""`run`: making what a workflow lacks."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.console.console import (
    Json,
    Package,
    Settings,
    StageNames,
    StoreAddress,
    VarsFiles,
    WorkflowFile,
    command_line,
    near,
    reported,
    say,
    where_it_is,
)
from pipeline.console.output import lossy_output

if TYPE_CHECKING:
    from pipeline.console.progress import Display
    from pipeline.console.project import Project
    from pipeline.events import Summary
    from pipeline.resources import Resources
    from pipeline.run.executor import Executor
    from pipeline.store.store import Store
    from pipeline.workflow.graph import Graph


def run(
    workflow: WorkflowFile,
    stages: StageNames = None,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    workers: Annotated[int, typer.Option("--workers", min=1, metavar="N", help="Number of parallel stages.")] = min(
        2, os.cpu_count() or 1
    ),
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="A dask scheduler that is already running.")
    ] = None,
    resources: Annotated[
        str,
        typer.Option(
            "--resources",
            metavar="LIST",
            envvar="GS_HIDER_RESOURCES",
            help="What this machine has, such as 'gpu=1 memory=16GiB'; workers of a scheduler state their own.",
        ),
    ] = "",
    serial: Annotated[bool, typer.Option("--serial", help="Runs one stage at a time, in this process.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only says what would be done, and why.")] = False,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Runs a workflow: reuses the results that are in the store, and makes the rest.

    \b
    python -m pipeline run workflows/hide_multi.yaml
    python -m pipeline run workflows/hide_multi.yaml --set iterations=300 --set hide.lambda_message=1.0
    python -m pipeline run workflows/hide_photos.yaml --set cover=photos/kitchen --set message=photos/fox
    python -m pipeline run workflows/hide_photos.yaml --vars my_profile.yaml --set cover=photos/kitchen
    python -m pipeline run workflows/hide_multi.yaml cover --dry-run

    Exit status: 0 done, 1 a stage failed, 2 the command or the workflow is wrong, 130 interrupted.
    """
    with nullcontext() if dry_run else lossy_output(), reported(store):
        from pipeline.console.plan_words import print_plan
        from pipeline.console.project import open_project
        from pipeline.plan.plan import make_plan
        from pipeline.resources import read_resources

        stated = read_resources(resources)
        project = open_project(
            workflow, store, settings or [], package, vars_files or [], make=not dry_run, stages=stages or []
        )
        graph = project.graph.needed_for(stages) if stages else project.graph
        if dry_run:
            print_plan(make_plan(graph, project.store), as_json)
            if not as_json:
                print(where_it_is(project.store))
            return
        make_executor = _executor_maker(workers, scheduler, stated, serial)
        ready = partial(_made_ready, make_executor, graph, project.store, serial or not scheduler)
        summary = _run(project, graph, ready, not serial, as_json)
        if summary.interrupted:
            say(f"Interrupted; completed work is kept. To continue: {command_line()}")
            raise typer.Exit(130)
        if summary.counts.get("failed"):
            say(f"Completed work is kept. Once the cause is fixed, continue with: {command_line()}")
            raise typer.Exit(1)


def _run(
    project: Project, graph: Graph, make_executor: Callable[[Display], Executor], captures: bool, as_json: bool
) -> Summary:
    """Runs a graph and displays it. `make_executor` is called only if there is work to do, and may display notes."""
    from pipeline.console.progress import make_display
    from pipeline.console.wording import summary_words
    from pipeline.events import Noted
    from pipeline.run.runner import Run
    from pipeline.store.other_runs import MIXED, beside_others

    display = make_display(graph.workflow, len(graph.nodes), json=as_json)
    with display, beside_others(project.store, graph.workflow) as others:
        if others:
            display(Noted(f"another run of {graph.workflow} is in progress: {MIXED}"))
        make = partial(make_executor, display)
        work = Run(graph, project.store, project.package, project.package_folder, make, captures, display.__call__)
        summary = work.run()
    if not as_json:
        say(summary_words(graph.workflow, summary))
        for path in work.reports():
            print(f"Open {near(path)}")
        print(where_it_is(project.store))
    return summary


def _executor_maker(workers: int, scheduler: str | None, resources: Resources, serial: bool) -> Callable[[], Executor]:
    def make() -> Executor:
        if serial:
            from pipeline.run.executor import SerialExecutor

            return SerialExecutor()
        # Importing dask takes a second, which a cached run should not spend.
        from pipeline.run.cluster import DaskExecutor

        return DaskExecutor(workers, scheduler, resources)

    return make


def _made_ready(make: Callable[[], Executor], graph: Graph, store: Store, here: bool, display: Display) -> Executor:
    """Calls `make`, after displaying what a person may not expect of the run.

    If the workers are `here`, first checks that they can do the work. Raises UserError if they cannot, and RemoteError
    if they are `here` and the bucket cannot be reached.
    """
    from pipeline.console.project import LIBRARIES
    from pipeline.errors import RemoteError
    from pipeline.events import Noted
    from pipeline.plan.foretelling import foretold
    from pipeline.plan.plan import make_plan
    from pipeline.plan.readiness import check_readiness
    from pipeline.plan.room import lacking_room

    try:
        steps = make_plan(graph, store)
    except RemoteError:
        if here:
            raise
        return make()  # the workers may reach the bucket, and the run looks up each stage again
    to_do = [graph.nodes[name] for name, step in steps.items() if step.state != "cached"]
    if here:
        check_readiness(to_do, LIBRARIES)
    for words in (lacking_room(to_do, store), *foretold(graph, steps)):
        if words:
            display(Noted(words))
    return make()
