"""`accept`: keeps results after a code change that a person knows to be cosmetic.

A key cannot tell that a renamed variable changes no bit, and hours of training are too high a price for it. Accepting a
stage writes one more record, under its new key and with the old outputs. The record notes the old key, the time, the
commit and the changes; explanations of the result, and reports on anything made from it, mention them. Only code, the
declared version and the format of keys can be accepted. Parameters, inputs, files and privacy say what was asked for,
so a change there cannot; nor can a result whose outputs no longer match those that the stage declares.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.canonical import Json
from pipeline.errors import CommandError
from pipeline.plan.changes import FAILED, Change
from pipeline.plan.keys import ACCEPTABLE, key_parts
from pipeline.plan.plan import Step, make_plan
from pipeline.provenance import now
from pipeline.stage import output_is_private
from pipeline.store.history import StageResult
from pipeline.store.record import Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, Node, Source

GONE = "it has no complete result in the store"


@dataclass(frozen=True)
class Acceptance:
    """A result to keep: `record` is the new record, `old` the key under which the result was made."""

    name: str
    old: str
    record: Record

    @property
    def changes(self) -> list[str]:
        """The accepted changes, in words."""
        return list(self.record.accepted[-1]["changes"])


@dataclass(frozen=True)
class Refusal:
    """A result that cannot be kept, with every reason why."""

    name: str
    reasons: list[str]

    def __str__(self) -> str:
        return f"{self.name} cannot be accepted: {'; '.join(self.reasons)}"


def acceptances(graph: Graph, store: Store, stage: str, commit: str | None) -> tuple[list[Acceptance], list[Refusal]]:
    """What accepting `stage` (a name in the file, or one item of a foreach) would keep, and what it cannot keep.

    Both lists are empty if everything is cached. As in a run, an item that cannot be kept does not hold up the others.
    Raises CommandError if there is no such stage, or if nothing can be kept; it then gives the reasons for every item.
    """
    part = graph.needed_for([stage])
    steps = make_plan(part, store)
    asked = [step for name, step in steps.items() if stage in (name, name.partition("[")[0]) and step.state != "cached"]
    judged = _judged(asked, part, steps, store, commit)
    found = [each for each in judged if isinstance(each, Acceptance)]
    refused = [each for each in judged if isinstance(each, Refusal)]
    if refused and not found:
        raise CommandError("\n".join(map(str, refused)), remedy=_remedy(part, steps, refused))
    return found, refused


def all_acceptances(graph: Graph, store: Store, commit: str | None) -> list[Acceptance]:
    """What accepting all changes of code would keep, what others wait for first; empty if everything is cached.

    Raises CommandError if something has to run, and nothing can be kept.
    """
    found: dict[str, Acceptance] = {}
    while True:
        # Only as if these were kept are the inputs of the next known.
        steps = make_plan(graph, store, {key: acceptance.record for key, acceptance in found.items()})
        judged = _judged([step for step in steps.values() if is_acceptable(step)], graph, steps, store, commit)
        new = {each.record.key: each for each in judged if isinstance(each, Acceptance)}
        if not new:
            break
        found |= new
    if not found and any(step.state != "cached" for step in steps.values()):
        raise CommandError(
            "there is nothing to accept: no stage would run because of a code change alone",
            remedy="`status` says why each would run.",
        )
    return [*found.values()]


def _judged(
    asked: Iterable[Step], graph: Graph, steps: Mapping[str, Step], store: Store, commit: str | None
) -> list[Acceptance | Refusal]:
    """What can be said of the earlier result of each of these steps."""
    digests: dict[Source, str | None] = {
        Source(name, output): step.result.outputs.get(output) if step.result else None
        for name, step in steps.items()
        for output in graph.nodes[name].declaration.outputs
    }
    judged: list[Acceptance | Refusal] = []
    for step in asked:
        node = graph.nodes[step.name]
        record = store.find(step.before) if step.before else None
        reasons = _reasons_against(step, record) or [*_misfits(node, record, store, digests)]
        if reasons or record is None or step.key is None:
            judged.append(Refusal(step.name, reasons))
        else:
            judged.append(_acceptance(step, step.key, record, key_parts(node, digests), commit))
    return judged


def _remedy(graph: Graph, steps: Mapping[str, Step], refused: Sequence[Refusal]) -> str:
    """What to do if nothing can be kept."""
    waiting = all(steps[refusal.name].key is None and GONE not in refusal.reasons for refusal in refused)
    first = to_accept_first(graph, steps, [refusal.name for refusal in refused]) if waiting else []
    if first:
        return f"Only code changed upstream: accept {first[0]} first."
    return "Only a code change can be accepted; for any other change, run the stage."


def keep(found: Sequence[Acceptance], graph: Graph, store: Store) -> None:
    """Writes the records, then a journal of everything that is cached now, on which `gc` and `explain` rely.

    Raises CommandError while `gc` deletes from the store, OSError if the journal or a link in `latest` cannot be made.
    """
    with store.in_use():
        for acceptance in found:
            with store.lock(acceptance.record.key):
                store.add(acceptance.record)
        journal = store.history.begin(graph.workflow, accepted=[acceptance.name for acceptance in found])
        try:
            for name, step in make_plan(graph, store).items():
                if step.result and step.key:
                    result = step.result
                    journal.add(StageResult(name, "cached", step.key, result.outputs, result.seconds, result.private))
                    store.link_latest(graph.workflow, name, result.outputs)
        finally:
            journal.close()


def still_to_accept(graph: Graph, store: Store) -> list[str]:
    """Stages of the graph that would run only because of changes that could be accepted, too."""
    return [name for name, step in make_plan(graph, store).items() if is_acceptable(step)]


def is_acceptable(step: Step) -> bool:
    """Whether a stage would run only because of changes that can be accepted.

    False while a run is doing it: accepting would not stop that run.
    """
    return bool(step.changes) and step.key is not None and step.state != "running" and not _unacceptable(step)


def to_accept_first(graph: Graph, steps: Mapping[str, Step], names: Iterable[str]) -> list[str]:
    """The stages, in order, whose acceptance is all that the uncached stages among `names` wait for.

    A stage among `names` that waits for nothing is itself included. Empty if one of them has to run in any case, or if
    all are cached.
    """
    asked, found = list(names), set()
    seen: set[str] = set()
    while asked:
        name = asked.pop()
        step = steps[name]
        if step.state == "cached" or name in seen:
            continue
        seen.add(name)
        if is_acceptable(step):
            found.add(name)
        elif step.key is None and step.changes and all(map(_passes, step.changes)):
            asked += graph.nodes[name].upstream
        else:
            return []
    return [name for name in graph.nodes if name in found]


def _passes(change: Change) -> bool:
    """Whether a change can be accepted, or may disappear when stages upstream are accepted."""
    waits = change.part == "input" and "source" in change.details and change.after is None and change.before != FAILED
    return waits or change.part in ACCEPTABLE


def _misfits(node: Node, record: Record | None, store: Store, digests: Mapping[Source, str | None]) -> Iterator[str]:
    """How the result differs from what the stage would make now: other outputs, kinds or privacy."""
    declared, made = node.declaration.outputs, record.outputs if record else {}
    if declared.keys() != made.keys():
        yield f"its outputs are now {', '.join(declared) or 'none'}; its result has {', '.join(made) or 'none'}"
        return
    given = [digests[source] for sources in node.sources.values() for source in sources]
    from_input = any(store.artifact(digest).private for digest in given if digest)
    for name, output in declared.items():
        artifact = store.artifact(made[name])
        if artifact.kind != output.kind:
            yield f"its output {name} is now of kind {output.kind}; its result is of kind {artifact.kind}"
        if artifact.private != output_is_private(output, from_input, node.private):
            now, then = ("public", "private") if artifact.private else ("private", "public")
            yield f"its output {name} is now {now}; its result is {then}"


def _reasons_against(step: Step, record: Record | None) -> list[str]:
    if record is None:
        return [GONE]
    if step.key is None:
        waits = [change.text for change in step.changes if change.part == "input"]
        return waits or ["its inputs have not been made yet"]
    return _unacceptable(step)


def _unacceptable(step: Step) -> list[str]:
    return [change.text for change in step.changes if change.part not in ACCEPTABLE]


def _acceptance(step: Step, key: str, record: Record, parts: Mapping[str, Json], commit: str | None) -> Acceptance:
    note: dict[str, Any] = {
        "from": record.key,
        "when": now(),
        "commit": commit,
        "changes": [change.text for change in step.changes],
    }
    provenance = {**record.provenance, "accepted": [*record.accepted, note]}
    return Acceptance(step.name, record.key, Record(key, parts, record.outputs, provenance))
