"""Runs small workflows of the toy stages in the test's process."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.artifact import Artifact
from pipeline.console.project import Project, open_project
from pipeline.errors import WorkflowError
from pipeline.events import Event, StageEnded, Summary
from pipeline.plan.plan import Step, make_plan
from pipeline.run.executor import Executor, SerialExecutor
from pipeline.run.runner import RETRIES, Run

TOYS = "tests.pipeline.toys"
CHAIN = """
    name: chain
    vars: {count: 3, factor: 2.0}
    stages:
      base:  {uses: numbers, with: {count: "${count}"}}
      twice: {uses: scale, in: {numbers: base}, with: {factor: "${factor}"}}
      other: {uses: scale, in: {numbers: base}, with: {factor: 5}}
      sum:   {uses: total, in: {numbers: [twice, other.numbers]}}
    """
"""A workflow of four stages: one makes numbers, two scale them, one adds up what these make."""
PROVENANCE: Mapping[str, object] = {
    "started": "2026-01-01T00:00:00+00:00",
    "seconds": 1.0,
    "versions": {},
    "machine": {},
    "facts": {},
    "private": False,
}
"""The least that a record tells."""


@dataclass
class Ran:
    """What a run did: its events, by stage and in order, and its summary."""

    project: Project
    ended: dict[str, StageEnded]
    summary: Summary
    events: list[Event]

    @property
    def states(self) -> dict[str, str]:
        return {name: event.state for name, event in self.ended.items()}

    def artifact(self, name: str, output: str = "numbers") -> Artifact:
        return self.project.store.artifact(self.ended[name].outputs[output].name)

    def values(self, name: str, output: str = "numbers") -> np.ndarray:
        return self.artifact(name, output).read("values")


class Workspace:
    """A folder with a workflow file and a store."""

    def __init__(self, folder: Path, package: str = TOYS) -> None:
        self.folder = folder
        self.package = package
        self.file = folder / "workflow.yaml"

    def write(self, text: str) -> Workspace:
        self.file.write_text(textwrap.dedent(text))
        return self

    def open(self, *settings: str, vars_files: Sequence[Path] = ()) -> Project:
        return open_project(self.file, self.folder / "store", settings, self.package, vars_files)

    def plan(self, *settings: str) -> dict[str, Step]:
        project = self.open(*settings)
        return make_plan(project.graph, project.store)

    def problems(self, *settings: str, vars_files: Sequence[Path] = ()) -> list[str]:
        """What is wrong with the workflow, without the file's name."""
        try:
            self.open(*settings, vars_files=vars_files)
        except WorkflowError as error:
            return [str(problem).removeprefix(f"{self.file}:") for problem in error.problems]
        return []

    def run(
        self, *settings: str, stages: Sequence[str] = (), executor: Executor | None = None, retries: int = RETRIES
    ) -> Ran:
        project = self.open(*settings)
        graph = project.graph.needed_for(stages) if stages else project.graph
        events: list[Event] = []
        work = Run(
            graph,
            project.store,
            project.package,
            project.package_folder,
            lambda: executor or SerialExecutor(),
            captures=executor is not None,
            tell=events.append,
            retries=retries,
        )
        summary = work.run()
        ended = {event.name: event for event in events if isinstance(event, StageEnded)}
        return Ran(project, ended, summary, events)
