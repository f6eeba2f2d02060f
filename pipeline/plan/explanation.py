"""Why a stage would run again, down to the changes that cause it; or what its result was made of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pipeline.plan.changes import Change, changes
from pipeline.plan.keys import key_parts
from pipeline.plan.known import Known
from pipeline.plan.plan import Step
from pipeline.store.record import Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, Node, Source


@dataclass(frozen=True)
class Cause:
    """A change of a stage upstream; `way` leads from the explained stage to the changed one, both included."""

    way: tuple[str, ...]
    change: Change

    @property
    def text(self) -> str:
        """The change in words, after the name of its stage."""
        return f"because {self.way[-1]}: {self.change.text}"

    @property
    def as_json(self) -> dict[str, Any]:
        """The change and the way to it as JSON fields."""
        return {"stage": self.way[-1], "way": list(self.way), **self.change.as_json}


@dataclass(frozen=True)
class Explanation:
    """Explains a step. For a cached result, `record` is its record and `run` the name of the run that made it."""

    step: Step
    causes: tuple[Cause, ...] = ()
    record: Record | None = None
    run: str | None = None


def explain(graph: Graph, steps: Mapping[str, Step], store: Store, names: Iterable[str]) -> Iterator[Explanation]:
    """Explains the steps of the stages `names`; `steps` must include those of everything that they depend on."""
    return map(_Explainer(graph, steps, store).explanation, names)


class _Explainer:
    def __init__(self, graph: Graph, steps: Mapping[str, Step], store: Store) -> None:
        self.graph = graph
        self.steps = steps
        self.store = store
        self.known = Known(store)
        self.journals = self.all_journals()
        self.runs: dict[str, str] = {}
        self.digests: dict[Source, str | None] = {
            Source(name, output): step.result.outputs.get(output) if step.result else None
            for name, step in steps.items()
            for output in graph.nodes[name].declaration.outputs
        }

    def explanation(self, name: str) -> Explanation:
        step = self.steps[name]
        if step.state == "cached" and step.key:
            return Explanation(step, record=self.store.record(step.key), run=self.run_that_made(step.key))
        return Explanation(step, tuple(self.causes((name,), step.changes, set())))

    def causes(self, way: tuple[str, ...], found: tuple[Change, ...], seen: set[tuple[str, str]]) -> Iterator[Cause]:
        """The changes behind the inputs among `found`, and behind the inputs of the changed stages, each once."""
        for change in found:
            upstream, was = change.details.get("source"), str(change.before)
            if change.part != "input" or upstream is None or (upstream, was) in seen:
                continue
            seen.add((upstream, was))
            behind = self.changes_since(self.graph.nodes[upstream], was)
            onward = (*way, upstream)
            for deeper in behind:
                if "source" not in deeper.details:
                    yield Cause(onward, deeper)
            yield from self.causes(onward, behind, seen)

    def changes_since(self, node: Node, digest: str) -> tuple[Change, ...]:
        """What changed about a stage since it made the artifact `digest`; empty if that is unknown."""
        record = self.maker(node.name, digest)
        return changes(node, record.parts, key_parts(node, self.digests), self.known) if record else ()

    def maker(self, name: str, digest: str) -> Record | None:
        """The newest record of an action that made an artifact, preferably for the stage `name`; None if unknown."""
        makers = self.makers.get(digest, {})
        for key in sorted(makers, key=lambda key: makers[key] != name):
            record = self.store.record(key)
            if record and record.parts["stage"] == self.graph.nodes[name].uses:
                return record
        return None

    @cached_property
    def makers(self) -> dict[str, dict[str, str]]:
        """For each artifact in the journals, the keys of the actions that made it, newest first.

        The value of each key is the stage for which the action was last done or found.
        """
        makers: dict[str, dict[str, str]] = {}
        history = self.store.history
        for journal in history.journals(self.graph.workflow):
            for result in history.results(journal).values():
                for digest in result.outputs.values() if result.key else ():
                    makers.setdefault(digest, {}).setdefault(str(result.key), result.name)
        return makers

    def run_that_made(self, key: str) -> str | None:
        """The run, of this workflow or another, whose journal says that it did the action `key`; None if unknown."""
        while key not in self.runs:
            workflow, journal = next(self.journals, (None, None))
            if journal is None:
                return None
            for result in self.store.history.results(journal).values():
                if result.key and result.state == "ran":
                    self.runs.setdefault(result.key, f"{workflow}/{journal.stem}")
        return self.runs[key]

    def all_journals(self) -> Iterator[tuple[str, Path]]:
        """Each workflow and journal: this workflow first, and the newest journal of each workflow first."""
        history = self.store.history
        others = (name for name in history.workflows() if name != self.graph.workflow)
        for workflow in (self.graph.workflow, *others):
            for journal in history.journals(workflow):
                yield workflow, journal


def in_words(explanation: Explanation, graph: Graph, duration: str) -> list[str]:
    """The explanation in lines for a person; `duration` is how long the action took, in words."""
    step = explanation.step
    if explanation.record:
        lines = [f"{step.name}: cached", *_made_of(explanation, graph, duration)]
    elif step.state == "running":
        lines = [f"{step.name}: running now"]
    elif step.state == "depends":
        lines = [f"{step.name}: to run if its inputs turn out different"]
    elif step.state in ("lost", "refused"):
        lines = [f"{step.name}: {'lost' if step.state == 'lost' else 'to accept'}"]
    else:
        lines = [f"{step.name}: to run, because"]
    lines += [f"  {reason}" for reason in step.reasons]
    lines += dict.fromkeys(f"  {cause.text}" for cause in explanation.causes)  # two inputs may have the same cause
    return lines + ([f"  it {step.failed_before}"] if step.failed_before else [])


def as_json(explanation: Explanation) -> dict[str, object]:
    """The explanation as JSON fields."""
    step, record = explanation.step, explanation.record
    return {
        "event": "explain",
        "name": step.name,
        "state": step.state,
        "key": step.key,
        "reasons": list(step.reasons),
        "changes": [change.as_json for change in step.changes],
        "causes": [cause.as_json for cause in explanation.causes],
        "failed": step.failed,
        "made": {
            "parts": record.parts,
            "outputs": record.outputs,
            "started": record.provenance.get("started"),
            "seconds": record.seconds,
            "commit": record.provenance.get("commit"),
            "run": explanation.run,
            "accepted": list(record.accepted),
            "from_accepted": list(record.provenance.get("from_accepted", ())),
        }
        if record
        else None,
    }


def _made_of(explanation: Explanation, graph: Graph, duration: str) -> Iterator[str]:
    record, step = explanation.record, explanation.step
    assert record is not None
    parts: Mapping[str, Any] = record.parts
    provenance = record.provenance
    run = f", in run {explanation.run}" if explanation.run else ""
    yield f"  made {provenance['started']} in {duration}, at commit {provenance['commit'] or 'unknown'}{run}"
    yield f"  key {step.key}"
    yield f"  stage {parts['stage']}, version {parts['version']}{', private' if parts['private'] else ''}"
    if parts["parameters"]:
        yield f"  parameters: {', '.join(f'{name} {value}' for name, value in parts['parameters'].items())}"
    for name, digests in parts["external"].items():
        if digests:
            yield f"  files of {name}: {', '.join(digest[:8] for digest in digests)}"
    for name, sources in graph.nodes[step.name].sources.items():
        made = [f"{s.node}.{s.output} ({d[:8]})" for s, d in zip(sources, parts["inputs"][name], strict=True)]
        if made:
            yield f"  input {name}: {', '.join(made)}"
    yield f"  code {parts['code'][:8]}"
    for acceptance in record.accepted:
        yield f"  accepted {acceptance['when']} although: {'; '.join(acceptance['changes'])}"
    for name in provenance.get("from_accepted", ()):
        yield f"  made from a result of {name} that was accepted although its code had changed"
