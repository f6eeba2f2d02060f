"""A workflow together with its store and the stages that it can use: where every command starts."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.code.declaration import Catalogue
from pipeline.collection import without_collection
from pipeline.errors import CommandError, PipelineError, Place
from pipeline.store.absent_store import AbsentStore
from pipeline.store.external_cache import ExternalCache
from pipeline.store.opening import open_store
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, build_graph
from pipeline.workflow.located import Problems
from pipeline.workflow.repeating import command_of
from pipeline.workflow.workflow import read_workflow

LIBRARIES = ("opencl",)
"""First-party packages, besides those of stages, whose code results depend on."""

OURS = "stages"
"""The package of the project's own stages, which stages of another package may use."""


@dataclass(frozen=True)
class Project:
    """The graph of a workflow, its store, and the package of its stages."""

    graph: Graph
    store: Store
    package: str
    package_folder: Path


def open_project(
    file: Path,
    store: str | Path,
    settings: Sequence[str] = (),
    package: str = "stages",
    vars_files: Sequence[Path] = (),
    make: bool = True,
    stages: Sequence[str] = (),
) -> Project:
    """Reads and checks a workflow, and opens its store.

    A missing store is created only if `make` and if nothing is wrong: in a wrong folder, it would be all that is left
    of a mistake. Otherwise an empty store stands in for it. Raises WorkflowError with everything that is wrong,
    CommandError for a bad store, or if one of `stages` is not in the workflow.
    """
    problems = Problems()
    with without_collection():
        workflow = read_workflow(file, settings, problems, vars_files)
        opened = _opened(store, make=False)
        if problems.missing and not settings and not vars_files:
            with suppress(PipelineError, OSError):  # a bucket that cannot be reached must not hide the problems
                _remind(problems, file, opened.history.last_given(workflow.name))
        catalogue = Catalogue(package, (OURS, *LIBRARIES), opened)

        def external() -> ExternalCache:
            nonlocal opened
            if make and isinstance(opened, AbsentStore):
                opened = _opened(store, make=True)
                catalogue.keep_in(opened)
            return ExternalCache(opened, sys.stderr)

        graph = build_graph(workflow, catalogue, external, problems, stages)
    given = [word for vars_file in vars_files for word in ("--vars", str(vars_file))]
    given += [word for setting in settings for word in ("--set", setting)]
    command = command_of(file, settings, vars_files, workflow, graph)
    graph = replace(graph, command=command, given=tuple(given))
    module = catalogue.sources.module(package)
    return Project(graph, opened, package, module.path.parent if module else Path.cwd())


def _opened(address: str | Path, make: bool) -> Store:
    try:
        return open_store(address, make)
    except OSError as error:
        raise CommandError(
            "cannot be used as a store",
            where=address,
            found=error.strerror,
            remedy="Name a folder that you can write to, with --store or $GS_HIDER_STORE.",
        ) from error


def _remind(problems: Problems, file: Path, given: Sequence[str]) -> None:
    """Adds the options of the last run to `problems`: most often, they are what is missing now."""
    if given:
        problems.add(Place(str(file)), f"its last run in this store was given {shlex.join(given)}")
