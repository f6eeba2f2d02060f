"""What a run would do, and why, as far as that can be known before anything runs.

A plan lists the folders of the store once, reads the journals of the last runs, and opens a record only for a stage
that these do not cover, so that thousands of finished stages are planned in a second. It does not check whether
artifacts are whole: a run does, and makes again those that are not. Only results that no run can make again are checked
here, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from pipeline.collection import without_collection
from pipeline.plan.changes import Change, changes
from pipeline.plan.keys import key_of, key_parts
from pipeline.plan.kindred import Kindred
from pipeline.plan.known import Known
from pipeline.plan.loss import refusal, words_of_loss
from pipeline.store.history import LastResult, StageResult
from pipeline.store.record import Record
from pipeline.store.stage_log import is_log_of
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, Node, Source

PlanState = Literal["cached", "running", "run", "depends", "shared", "lost", "refused"]


@dataclass(frozen=True)
class Step:
    """A node in the plan.

    `cached`: already done, with this `result`. `running`: a run is doing it; the first of `reasons` says where to read
    more. `run`: to be done, for `reasons`. `depends`: to be done if inputs that are not made yet come out differently.
    `shared`: does the same as an earlier stage, which does it for both. `lost`: damaged or gone, and a run refuses to
    replace it. `refused`: only its code changed, and a run refuses to replace a result that it cannot make again.

    `key` is None until all inputs are made. `before` is the key of the earlier result that it is compared with (see
    `Kindred`), `changes` are the differences, and part of the reasons unless it is refused. `failed` is the cause of a
    failure since the last result.
    """

    name: str
    state: PlanState
    key: str | None
    reasons: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    result: StageResult | None = None
    failed: str | None = None
    before: str | None = None

    @property
    def failed_before(self) -> str | None:
        """That it failed last time, and why; None if it did not. Without a `key`, the inputs may have been others."""
        if self.failed is None:
            return None
        return f"failed last time{'' if self.key else ', with these inputs or others'}: {self.failed}"


def make_plan(graph: Graph, store: Store, kept: Mapping[str, Record] | None = None) -> dict[str, Step]:
    """The steps of a run by node, in the order of the graph, as if the records `kept` (by key) were in the store."""
    with without_collection():
        return _Planner(graph, store, kept or {}).plan()


class _Planner:
    def __init__(self, graph: Graph, store: Store, kept: Mapping[str, Record]) -> None:
        self.graph = graph
        self.store = store
        self.kept = kept
        self.last = store.history.last(graph.workflow, graph.nodes.keys())
        self.kindred = Kindred(graph.workflow, store)
        self.actions = store.actions
        self.objects = store.objects
        self.known = Known(store)

    def plan(self) -> dict[str, Step]:
        digests: dict[Source, str | None] = {}
        steps = {}
        works: dict[Source, str] = {}
        workers: dict[str, str] = {}
        for name, node in self.graph.nodes.items():
            step = self.step(node, digests, self.last[name])
            if not step.result:
                work = self.work(node, digests, works)
                first = workers.setdefault(work, name)
                if first != name:
                    step = replace(step, state="shared", reasons=(f"does the same as {first}",))
                works |= {Source(name, output): f"{work} {output}" for output in node.declaration.outputs}
            steps[name] = step
            for output in node.declaration.outputs:
                digests[Source(name, output)] = step.result.outputs.get(output) if step.result else None
        return steps

    def work(self, node: Node, digests: Mapping[Source, str | None], works: Mapping[Source, str]) -> str:
        """A hash of the work to be done, equal for nodes that will have the same key.

        An input that is not made yet counts by the work that will make it.
        """
        given = {source: digests[source] or works[source] for sources in node.sources.values() for source in sources}
        return key_of(key_parts(node, given))

    def step(self, node: Node, digests: Mapping[Source, str | None], last: LastResult) -> Step:
        parts = key_parts(node, digests)
        known = all(digests[source] is not None for sources in node.sources.values() for source in sources)
        key = key_of(parts) if known else None
        lost = self.loss(node, key) if key else None
        if lost:
            return Step(node.name, "lost", key, (lost,))
        result = self.result(node.name, key, last.made) if key else None
        if result:
            return Step(node.name, "cached", key, result=result)
        before = self.kindred.before(node, key, parts, last.made)
        step = replace(self.missing(node, key, parts, last, before), before=before.key if before else None)
        if key and self.store.is_locked(key):
            return self.running(step, key)
        refused = refusal(node, key, parts, before, self.graph, self.store) if key else None
        return replace(step, state="refused", reasons=(refused,)) if refused else step

    def missing(
        self, node: Node, key: str | None, parts: Mapping[str, Any], last: LastResult, before: Record | None
    ) -> Step:
        """The step of a node whose result is not in the store, compared with the result `before`."""
        if before is None:
            reason = "its last result is no longer in the store" if last.made else "it has never run"
            return Step(node.name, "run", key, (reason,), failed=last.cause(key))
        changed = changes(node, before.parts, parts, self.known)
        if not changed:
            reason = "its last result is no longer complete in the store"
            return Step(node.name, "run", key, (reason,), failed=last.cause(key))
        waits_only = all(change.part == "input" and _waits(change) for change in changed)
        state: PlanState = "depends" if waits_only else "run"
        return Step(node.name, state, key, tuple(change.text for change in changed), changed, failed=last.cause(key))

    def running(self, step: Step, key: str) -> Step:
        """The same step while a run is doing it: a run of this workflow, or of another that has to do the same."""
        logs = [self.store.log(self.graph.workflow, step.name, private) for private in (False, True)]
        log = next((f"log: {log}" for log in logs if is_log_of(key, log)), "as another stage, or in another workflow")
        return replace(step, state="running", reasons=(log, *(change.text for change in step.changes)))

    def loss(self, node: Node, key: str) -> str | None:
        """Why a run would fail because an irreplaceable result is damaged or gone; None if it is not."""
        remains = self.store.remains(key) if node.unrepeatable and self.store.find(key) is None else ()
        return words_of_loss(node.name, remains, self.graph, self.store) if remains else None

    def result(self, name: str, key: str, made: StageResult | None) -> StageResult | None:
        """What the action `key` made; None unless all of it is in the store."""
        if key not in self.actions and key not in self.kept:
            return None
        # A later run that found the result cached took no time: how long it took to make is in the record.
        made_then = made is not None and made.state != "cached" and made.key == key
        if made is not None and made_then and self.objects.issuperset(made.outputs.values()):
            return made
        record = self.kept.get(key) or self.store.record(key)
        if record is None or not self.objects.issuperset(record.outputs.values()):
            return None
        return StageResult(name, "cached", key, record.outputs, record.seconds, record.private)


def _waits(change: Change) -> bool:
    """Whether a change is merely an input that is not made yet."""
    return change.after is None and "source" in change.details
