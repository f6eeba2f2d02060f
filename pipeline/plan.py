"""What a run would do, and why, as far as it can be known before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pipeline.explain import changes, key_of, key_parts
from pipeline.graph import Graph, Node, Source
from pipeline.store import Record, Store


@dataclass(frozen=True)
class Step:
    """A node in the plan.

    `cached`: done already. `run`: to be done, for `reasons`. `depends`: to be done if what is made before it comes
    out differently. `key` is None as long as an input is not made. `failed` is the cause of a failure since the last
    result.
    """

    name: str
    state: Literal["cached", "run", "depends"]
    key: str | None
    reasons: tuple[str, ...]
    record: Record | None
    failed: str | None


def make_plan(graph: Graph, store: Store) -> dict[str, Step]:
    """The steps of a run, in order."""
    digests: dict[Source, str | None] = {}
    steps = {}
    for name, node in graph.nodes.items():
        step = _step(graph.workflow, node, digests, store)
        steps[name] = step
        for output in node.declaration.outputs:
            digests[Source(name, output)] = step.record.outputs.get(output) if step.record else None
    return steps


def _step(workflow: str, node: Node, digests: Mapping[Source, str | None], store: Store) -> Step:
    parts = key_parts(node, digests)
    known = all(digests[source] is not None for sources in node.sources.values() for source in sources)
    key = key_of(parts) if known else None
    record = store.find(key) if key else None
    last = store.last_result(workflow, node.name)
    if record:
        return Step(node.name, "cached", key, (), record, last["failed"])
    before = store.record(last["key"]) if last["key"] else None
    if before is None:
        reasons = ["its last result is no longer in the store" if last["key"] else "it has never run"]
    else:
        reasons = changes(node, before.parts, parts)
        if not reasons:
            reasons = ["its last result is no longer whole in the store"]
    waits_only = before is not None and all(" waits for " in reason for reason in reasons)
    return Step(node.name, "depends" if waits_only and not known else "run", key, tuple(reasons), None, last["failed"])
