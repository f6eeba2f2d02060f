"""The command line: `python -m pipeline run | status | explain | accept | graph | stages | show | export | verify | …`.

Each command imports what it needs only when it is called. So help and shell completion, for which a person waits, load
neither the engine nor any numeric library.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.console.bash_words import whole_words
from pipeline.console.commands_results import export, show
from pipeline.console.commands_stages import stages
from pipeline.console.commands_store import gc, pin, pins, unpin, verify
from pipeline.console.console import (
    Json,
    Package,
    Settings,
    StageName,
    StageNames,
    StageToAccept,
    StoreAddress,
    VarsFiles,
    WorkflowFile,
    command_line,
    command_line_with,
    near,
    reported,
    say,
    write_the_rest,
)
from pipeline.console.output import lossy_output, open_closed_streams, spell_what_cannot_be_printed
from pipeline.run.process import set_thread_policy

if TYPE_CHECKING:
    from pipeline.console.progress import Display
    from pipeline.console.project import Project
    from pipeline.events import Summary
    from pipeline.resources import Resources
    from pipeline.run.executor import Executor
    from pipeline.store.store import Store
    from pipeline.workflow.graph import Graph

COMMAND = "gs-hider"  # another name of the same program, which a shell can complete

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="""Runs workflows of stages, keeps every result, and repeats only what changed.

    \b
    python -m pipeline run workflows/hide_multi.yaml                  run it, or the part that is missing
    python -m pipeline status workflows/hide_multi.yaml               what is done, and what would run
    python -m pipeline explain workflows/hide_multi.yaml hide         why a stage would run
    python -m pipeline stages hide_scenes                             what a stage takes and makes; its parameters
    python -m pipeline show hide_multi/sealed.container               what came out, and how it was made
    python -m pipeline show hide_multi/cover.scene --pictures seen    its pictures as PNG files
    python -m pipeline gc --dry-run                                   what is no longer needed

    `COMMAND --help` shows more. The program is also called gs-hider: `gs-hider --install-completion` teaches your shell
    to complete workflows, stages, settings and results.
    """,
    context_settings={"max_content_width": 120},
)


def main() -> None:
    """Runs the command line, or answers a shell that asks for completions."""
    open_closed_streams()
    spell_what_cannot_be_printed()
    set_thread_policy()
    by_name = Path(sys.argv[0]).name == COMMAND or any(word.endswith("-completion") for word in sys.argv[1:2])
    asked_by_bash = os.environ.get(f"_{COMMAND.replace('-', '_').upper()}_COMPLETE") == "complete_bash"
    with whole_words(os.environ) if asked_by_bash else nullcontext():
        try:
            app(prog_name=COMMAND if by_name else "python -m pipeline")
        finally:
            write_the_rest()


@app.command()
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
                print(_store_words(project.store))
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


@app.command()
def status(
    workflow: WorkflowFile,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Shows whether the result of each stage is in the store and, if not, why, or that a run is making it right now.

    \b
    python -m pipeline status workflows/hide_multi.yaml
    """
    with reported(store):
        from pipeline.console.plan_words import print_plan
        from pipeline.console.project import open_project
        from pipeline.plan.plan import make_plan

        project = open_project(workflow, store, settings or [], package, vars_files or [], make=False)
        print_plan(make_plan(project.graph, project.store), as_json)
        if not as_json:
            print(_store_words(project.store))


@app.command()
def explain(
    workflow: WorkflowFile,
    stage: StageName,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Says why a stage would run again, down to the changes that cause it, or what its result was made from.

    \b
    python -m pipeline explain workflows/hide_multi.yaml hide
      hide: cached
        made 2026-03-01T10:00:00+00:00 in 4 min 10 s, at commit 3f2c…, in run hide_multi/20260301T100000.…
        …
    python -m pipeline explain workflows/hide_multi.yaml scores --set hide.lambda_message=1.0
      scores: to run if its inputs turn out different
        input container waits for hide
        because hide: parameter lambda_message: 0.3 → 1.0
    """
    with reported(store):
        from pipeline.console.project import open_project
        from pipeline.console.wording import duration
        from pipeline.plan.explanation import as_json as fields_of
        from pipeline.plan.explanation import explain as explained
        from pipeline.plan.explanation import in_words
        from pipeline.plan.plan import make_plan

        project = open_project(workflow, store, settings or [], package, vars_files or [], make=False, stages=[stage])
        steps = make_plan(project.graph, project.store)
        nodes = project.graph.needed_for([stage]).nodes
        names = [name for name, node in nodes.items() if stage in (name, node.entry)]
        for explanation in explained(project.graph, steps, project.store, names):
            if as_json:
                print(json.dumps(fields_of(explanation)))
            else:
                took = duration(explanation.record.seconds) if explanation.record else ""
                print("\n".join(in_words(explanation, project.graph, took)))


@app.command()
def accept(
    context: typer.Context,
    workflow: WorkflowFile,
    stage: StageToAccept = None,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only says what would be kept.")] = False,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Keeps results after a code change that does not affect them, such as a renamed variable.

    \b
    python -m pipeline accept workflows/hide_multi.yaml --dry-run
      hide: would be kept although code changed: stages.hiding.key (draw changed)
      sealed: would be kept although code changed: stages.hiding.key (draw changed)
    python -m pipeline accept workflows/hide_multi.yaml message_splats[reef]

    Results are not kept if parameters, inputs, files or privacy changed; in a foreach, this concerns only the items
    that changed. Exit status 2 if nothing can be kept. Explanations and reports mention that a result was accepted.
    """
    with reported(store):
        from pipeline.console.accept_words import print_acceptances, print_refusals
        from pipeline.console.project import open_project
        from pipeline.plain_text import listed
        from pipeline.plan.accept import acceptances, all_acceptances, keep, still_to_accept
        from pipeline.provenance import git_commit

        stages = [stage] if stage else []
        project = open_project(workflow, store, settings or [], package, vars_files or [], make=False, stages=stages)
        graph, results, commit = project.graph, project.store, git_commit(project.package_folder)
        found, refused = (
            acceptances(graph, results, stage, commit) if stage else (all_acceptances(graph, results, commit), [])
        )
        if not dry_run and found:
            keep(found, graph, results)
        print_acceptances(found, dry_run, as_json)
        print_refusals(refused, as_json)
        if not found:
            say(f"{stage or 'everything'}: cached; there is nothing to accept")
        remaining = still_to_accept(graph, results) if not dry_run else []
        if remaining:
            command = command_line_with(context, stage=remaining[0] if len(remaining) == 1 else None)
            say(f"the code of {listed(remaining)} changed, too: {command}")


@app.command()
def graph(
    workflow: WorkflowFile,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    svg: Annotated[
        Path | None, typer.Option("--svg", metavar="FILE", help="Draws the graph to an SVG file.", show_default=False)
    ] = None,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Shows the stages of a workflow and the stages from which each takes its inputs.

    \b
    python -m pipeline graph workflows/hide_multi.yaml --svg hide_multi.svg
    """
    with reported(store):
        from pipeline.console.plan_words import box, node_as_json
        from pipeline.console.project import open_project
        from pipeline.drawing import draw
        from pipeline.errors import CommandError
        from pipeline.plan.plan import make_plan

        project = open_project(workflow, store, settings or [], package, vars_files or [], make=False)
        nodes = project.graph.nodes.values()
        if svg:
            steps = make_plan(project.graph, project.store)
            drawing = draw([box(node, steps[node.name]) for node in nodes])
            try:
                svg.write_text(drawing, encoding="utf-8")
            except OSError as error:
                raise CommandError(
                    "the graph cannot be drawn there", where=svg, found=error.strerror, expected="a file to write"
                ) from error
            say(f"Drawn to {svg}")
            return
        width = max((len(node.name) for node in nodes), default=0)
        for node in nodes:
            if as_json:
                print(json.dumps(node_as_json(node)))
            else:
                takes = f"  ← {', '.join(node.upstream)}" if node.upstream else ""
                print(f"{node.name:{width}}  {node.uses}{' (private)' if node.private else ''}{takes}")


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
        print(_store_words(project.store))
    return summary


def _store_words(store: Store) -> str:
    from pipeline.store.absent_store import AbsentStore

    where = store.address if "://" in store.address else near(store.root)
    return f"The store is {where}{', which does not exist yet' if isinstance(store, AbsentStore) else ''}"


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


for command in (stages, show, export, verify, gc, pin, unpin, pins):
    app.command()(command)
