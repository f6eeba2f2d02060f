"""`verify`, `gc` and pins: keeping a store sound and small."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Annotated

import typer

from pipeline.console.completion import complete_known_workflow, complete_pin
from pipeline.console.console import (
    Json,
    Package,
    Settings,
    StageNames,
    StoreAddress,
    VarsFiles,
    WorkflowFile,
    reported,
    say,
)
from pipeline.plain_text import listed

DryRun = Annotated[bool, typer.Option("--dry-run", help="Only says what would be done.")]


def verify(store: StoreAddress = "store", dry_run: DryRun = False, as_json: Json = False) -> None:
    """Reads every byte of the store and sets aside what is damaged; the next run makes it again.

    \b
    python -m pipeline verify
    python -m pipeline verify --store /scratch/store --dry-run

    This checks artifacts, the records of how they were made, pins, and the links in `latest`. Damaged data moves to the
    store's folder `damaged`, until a `gc` finds that it was made again or is not needed. A file in an artifact that is
    not part of it moves there too, and the artifact stays. On a read-only disk, or in a store that you may not write,
    nothing moves. If the store is in a bucket, everything is fetched to be checked, and none of it is kept; a sound
    copy on this machine replaces damaged data in the bucket. Exit status: 0 everything is sound, 1 something was
    damaged.
    """
    with reported(store):
        from pipeline.console.store_words import Verified, verified_as_json, verified_words
        from pipeline.disk import is_read_only
        from pipeline.results.naming import open_existing
        from pipeline.store.verification import verify_store

        opened = open_existing(store)
        fixed = is_read_only(opened.root)  # nobody can delete anything there, nor hold a lock
        dry_run = dry_run or fixed
        with nullcontext() if fixed else opened.in_use():
            total = Verified()
            with total.shown(len(opened.objects), quiet=as_json) as progress:
                for checked in verify_store(opened, dry_run):
                    progress(checked)
                    if checked.damage:
                        print(json.dumps(verified_as_json(checked)) if as_json else verified_words(checked))
        print(json.dumps(total.as_json()) if as_json else total.words(dry_run, opened.damaged.folder))
        if total.damaged:
            raise typer.Exit(1)


def gc(
    store: StoreAddress = "store",
    dry_run: DryRun = False,
    keep_last: Annotated[
        int, typer.Option("--keep-last", min=1, metavar="N", help="Keeps the results of this many runs per workflow.")
    ] = 3,
    older_than: Annotated[
        float, typer.Option("--older-than", min=0, metavar="DAYS", help="Keeps all results that are younger than this.")
    ] = 0.0,
    forget: Annotated[
        list[str] | None,
        typer.Option(
            "--forget",
            metavar="NAME",
            help="A workflow whose runs no longer count. Repeatable.",
            autocompletion=complete_known_workflow,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Deletes the results that are no longer needed, and lists them.

    \b
    python -m pipeline gc --dry-run
    python -m pipeline gc --keep-last 1
    python -m pipeline gc --older-than 30 --dry-run
    python -m pipeline pin workflows/hide_multi.yaml --name paper     and gc keeps these results for ever

    It keeps the results that the last N runs of each workflow used, the last result of each of their stages with
    everything that it was made from, what is pinned, and what cannot be made again, such as keys. Only complete runs of
    a whole workflow count toward N; results of partial and interrupted runs since then are kept as well. So are
    checkpoints of runs that are kept, checkpoints younger than 14 days, and damaged data that is needed and was not
    made again. No run may use the store meanwhile, except with --dry-run. A gc that is interrupted leaves a valid
    store.

    gc does not see runs on other machines that use a store in a bucket, so it spares everything put there within a day.
    It may delete older results that such a run uses; they are then made again.
    """
    with reported(store):
        from pipeline.console.store_words import collection_as_json, collection_words
        from pipeline.results.naming import check_workflows, open_existing
        from pipeline.store.garbage import Rules, collect

        opened = open_existing(store)
        check_workflows(opened, forget or [])
        with opened.in_use(alone=not dry_run):
            collection = collect(opened, Rules(keep_last, older_than, frozenset(forget or [])))
            if not dry_run:
                collection.delete()
        for line in collection_as_json(collection) if as_json else collection_words(collection, dry_run):
            print(line)


def pin(
    workflow: WorkflowFile,
    stages: StageNames = None,
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="NAME", help="The name of the pin.", show_default="the workflow's name"),
    ] = None,
    settings: Settings = None,
    vars_files: VarsFiles = None,
    store: StoreAddress = "store",
    package: Package = "stages",
) -> None:
    """Keeps the results of a workflow, or of some of its stages and what they need, from `gc`, until `unpin`.

    \b
    python -m pipeline pin workflows/hide_multi.yaml
    python -m pipeline pin workflows/hide_multi.yaml hide --set iterations=30000 --name long_training
    """
    with reported(store):
        from pipeline.console.project import open_project
        from pipeline.errors import CommandError
        from pipeline.plan.accept import to_accept_first
        from pipeline.plan.plan import make_plan
        from pipeline.provenance import now
        from pipeline.store.pins import Pin

        project = open_project(
            workflow, store, settings or [], package, vars_files or [], make=False, stages=stages or []
        )
        graph = project.graph.needed_for(stages) if stages else project.graph
        with project.store.in_use():
            steps = make_plan(graph, project.store)
            lacking = [step.name for step in steps.values() if step.state != "cached"]
            if lacking:
                raise CommandError(
                    f"some of these results are not in the store: {listed(lacking)}",
                    where=workflow,
                    remedy=_before_pinning(to_accept_first(graph, steps, lacking)),
                )
            chosen = name or ".".join([graph.workflow, *(stages or [])])
            keys = {step.name: step.key for step in steps.values() if step.key}
            project.store.pins.add(chosen, Pin(graph.workflow, now(), keys))
        say(f"{len(keys)} results are pinned as {chosen}; `unpin {chosen}` releases them")


def _before_pinning(to_accept: Sequence[str]) -> str:
    """What to do before pinning: after a code change, a run may make results other than those that are to be kept."""
    if to_accept:
        return f"Only code changed, in {listed(to_accept)}: `accept` keeps these results; a run may make others."
    return "Run it first, or name the stages to pin."


def unpin(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name that `pins` lists.", autocompletion=complete_pin)],
    store: StoreAddress = "store",
) -> None:
    """Removes a pin: the next `gc` deletes its results unless something else needs them.

    \b
    python -m pipeline unpin long_training
    """
    with reported(store):
        from pipeline.results.naming import open_existing

        open_existing(store).pins.remove(name)
        say(f"{name} is no longer pinned")


def pins(store: StoreAddress = "store", as_json: Json = False) -> None:
    """Lists the pins: name, workflow, time, and number of results.

    \b
    python -m pipeline pins
    """
    with reported(store):
        from pipeline.console.store_words import pin_as_json, pins_words
        from pipeline.results.naming import open_existing

        opened = open_existing(store)
        found = {name: opened.pins.read(name) for name in opened.pins.names}
        actions = opened.actions
        if as_json:
            for name, kept in found.items():
                print(json.dumps(pin_as_json(name, kept, actions)))
        else:
            print("\n".join(pins_words(found, actions)))
