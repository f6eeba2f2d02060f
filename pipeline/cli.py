"""The command line: `python -m pipeline run | status | explain | graph`."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from pipeline.drawing import Box, draw
from pipeline.errors import PipelineError, UserError
from pipeline.events import Summary
from pipeline.executor import Executor, SerialExecutor
from pipeline.graph import Graph, Node
from pipeline.plan import Step, make_plan
from pipeline.process import set_thread_policy
from pipeline.progress import duration, make_display, summary_words
from pipeline.project import Project, open_project
from pipeline.runner import Run
from pipeline.store import Store

STATES = {"cached": "cached", "run": "to run", "depends": "depends"}

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Runs workflows of stages, keeps every result, and repeats only what changed.",
)

WorkflowFile = Annotated[Path, typer.Argument(metavar="WORKFLOW", help="The workflow file.", show_default=False)]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Sets a var, or a parameter as STAGE.PARAMETER. Repeatable."),
]
StoreAddress = Annotated[
    str,
    typer.Option(
        "--store",
        metavar="DIR",
        envvar="GS_HIDER_STORE",
        help="Where results are kept: a folder or s3://BUCKET/PREFIX.",
    ),
]
Package = Annotated[str, typer.Option("--stages", metavar="PACKAGE", help="The package whose modules are the stages.")]
Json = Annotated[bool, typer.Option("--json", help="Prints one JSON object a line.")]


def main() -> None:
    set_thread_policy()
    app(prog_name="python -m pipeline")


@app.command()
def run(
    workflow: WorkflowFile,
    stages: Annotated[
        list[str] | None,
        typer.Argument(metavar="STAGE", help="Only these and what they need.", show_default=False),
    ] = None,
    settings: Settings = None,
    store: StoreAddress = "store",
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
    with _reported():
        project = open_project(workflow, store, settings or [], package)
        graph = project.graph.needed_for(stages) if stages else project.graph
        if dry_run:
            _print_plan(make_plan(graph, project.store), as_json)
            return
        summary = _run(project, graph, _executor_maker(workers, scheduler, serial), not serial, as_json)
        if summary.interrupted:
            _say(f"Interrupted; what is done is kept. To go on: {_command()}")
            raise typer.Exit(130)
        if summary.counts.get("failed"):
            _say(f"What is done is kept. After a repair, go on with: {_command()}")
            raise typer.Exit(1)


@app.command()
def status(
    workflow: WorkflowFile,
    settings: Settings = None,
    store: StoreAddress = "store",
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Says of every stage whether its result is in the store, and if not, why.

    \b
    python -m pipeline status workflows/hide_multi.yaml
    """
    with _reported():
        project = open_project(workflow, store, settings or [], package)
        _print_plan(make_plan(project.graph, project.store), as_json)


@app.command()
def explain(
    workflow: WorkflowFile,
    stage: Annotated[str, typer.Argument(metavar="STAGE", help="A stage of the workflow.", show_default=False)],
    settings: Settings = None,
    store: StoreAddress = "store",
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Says why a stage would run again, or what its result was made of.

    \b
    python -m pipeline explain workflows/hide_multi.yaml hide --set hide.lambda_message=1.0
    """
    with _reported():
        project = open_project(workflow, store, settings or [], package)
        steps = make_plan(project.graph.needed_for([stage]), project.store)
        wanted = {name: step for name, step in steps.items() if stage in (name, name.partition("[")[0])}
        if as_json:
            _print_plan(wanted, as_json)
            return
        for step in wanted.values():
            print("\n".join(_explained(step, project.store)))


@app.command()
def graph(
    workflow: WorkflowFile,
    settings: Settings = None,
    store: StoreAddress = "store",
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
    with _reported():
        project = open_project(workflow, store, settings or [], package)
        nodes = project.graph.nodes.values()
        if svg:
            steps = make_plan(project.graph, project.store)
            svg.write_text(draw([_box(node, steps[node.name]) for node in nodes]))
            _say(f"Drawn into {svg}")
            return
        width = max((len(node.name) for node in nodes), default=0)
        for node in nodes:
            if as_json:
                print(json.dumps(_node_as_json(node)))
            else:
                takes = f"  ← {', '.join(node.upstream)}" if node.upstream else ""
                print(f"{node.name:{width}}  {node.uses}{' (private)' if node.private else ''}{takes}")


def _run(
    project: Project, graph: Graph, make_executor: Callable[[], Executor], captures: bool, as_json: bool
) -> Summary:
    display = make_display(graph.workflow, len(graph.nodes), json=as_json)
    with display:
        work = Run(
            graph, project.store, project.package, project.package_folder, make_executor, captures, display.__call__
        )
        summary = work.run()
    if not as_json:
        _say(summary_words(graph.workflow, summary))
        for path in work.reports():
            print(f"Open {_near(path)}")
        address = project.store.address
        print(f"The store is {address if '://' in address else _near(project.store.root)}")
    return summary


def _executor_maker(workers: int, scheduler: str | None, serial: bool) -> Callable[[], Executor]:
    def make() -> Executor:
        if serial:
            return SerialExecutor()
        from pipeline.cluster import DaskExecutor  # dask takes a second to import, which a cached run can do without

        return DaskExecutor(workers, scheduler)

    return make


def _print_plan(steps: Mapping[str, Step], as_json: bool) -> None:
    width = max((len(name) for name in steps), default=0)
    for name, step in steps.items():
        if as_json:
            print(json.dumps(_step_as_json(step)))
        else:
            print(f"{name:{width}}  {_state_words(step)}")
    if not as_json:
        counts = Counter(step.state for step in steps.values())
        print(", ".join(f"{number} {STATES[state]}" for state, number in sorted(counts.items())))


def _state_words(step: Step) -> str:
    if step.result:
        words = f"{STATES[step.state]}  {duration(step.result.seconds)}"
    else:
        words = f"{STATES[step.state]}  {'; '.join(step.reasons)}"
    return f"{words} (failed last time: {step.failed})" if step.failed else words


def _explained(step: Step, store: Store) -> list[str]:
    record = store.record(step.key) if step.key and step.state == "cached" else None
    if record:
        lines = [
            f"{step.name}: cached, made {record.provenance['started']} in {duration(record.seconds)}",
            f"  key {step.key}, commit {record.provenance['commit'] or 'unknown'}",
        ]
    elif step.state == "depends":
        lines = [f"{step.name}: to run if what it takes comes out differently"]
    else:
        lines = [f"{step.name}: to run, because"]
    lines += [f"  {reason}" for reason in step.reasons]
    return lines + ([f"  it failed last time: {step.failed}"] if step.failed else [])


def _step_as_json(step: Step) -> dict[str, object]:
    return {
        "event": "plan",
        "name": step.name,
        "state": step.state,
        "key": step.key,
        "reasons": step.reasons,
        "seconds": step.result.seconds if step.result else None,
        "failed": step.failed,
    }


def _node_as_json(node: Node) -> dict[str, object]:
    return {
        "event": "node",
        "name": node.name,
        "uses": node.uses,
        "inputs": {name: [f"{s.node}.{s.output}" for s in sources] for name, sources in node.sources.items()},
        "outputs": {name: output.kind for name, output in node.declaration.outputs.items()},
        "private": node.private,
    }


def _box(node: Node, step: Step) -> Box:
    lines = (node.uses, duration(step.result.seconds)) if step.result else (node.uses,)
    private = node.private or (step.result is not None and step.result.private)
    return Box(node.name, node.upstream, lines, "private" if private else "done" if step.result else "plain")


def _near(path: Path) -> Path:
    """The path as one would type it here."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _command() -> str:
    return shlex.join(["python", "-m", "pipeline", *sys.argv[1:]])


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


@contextmanager
def _reported() -> Iterator[None]:
    """Tells errors as messages; what is no message of ours is a defect of the engine and keeps its traceback."""
    try:
        yield
    except UserError as error:
        _say(str(error))
        raise typer.Exit(2) from None
    except PipelineError as error:
        _say(str(error))
        raise typer.Exit(1) from None
    except OSError as error:
        _say(f"{error.filename or 'the system'}: {error.strerror or error}")
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        _say(f"Interrupted at once; finished stages are kept. To go on: {_command()}")
        raise typer.Exit(130) from None
