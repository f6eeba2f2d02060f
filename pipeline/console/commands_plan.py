"""`status`, `explain`, `accept` and `graph`: what a run of a workflow would do, and why."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from pipeline.console.console import (
    Json,
    Package,
    Settings,
    StageName,
    StageToAccept,
    StoreAddress,
    VarsFiles,
    WorkflowFile,
    command_line_with,
    reported,
    say,
    where_it_is,
)


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
            print(where_it_is(project.store))


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
