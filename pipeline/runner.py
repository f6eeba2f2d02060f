"""A run: what is in the store is taken from there, the rest is done as soon as what it takes is made.

The engine decides what may start, and the executor where: so a failed stage holds up nothing but what depends on it,
results that a dead worker held need not be made again, and a fully cached run starts no worker at all.
"""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from pipeline.action import Job, Outcome, perform
from pipeline.canonical import Json
from pipeline.events import Event, Noted, StageEnded, State, Summary
from pipeline.executor import Executor, Lost
from pipeline.explain import key_of, key_parts
from pipeline.graph import Graph, Node, Source
from pipeline.provenance import git_commit
from pipeline.store import Store

GRACE = 60.0  # seconds that a running stage has to save its checkpoint and stop
MOMENT = 0.2  # seconds between two looks at the stop flag


@dataclass(frozen=True)
class Done:
    """A node whose outputs are in the store; `lineage` holds the keys of all actions behind it and its own."""

    key: str
    outputs: Mapping[str, str]
    lineage: Mapping[str, str]


@dataclass
class Run:
    """One run of a graph. `make_executor` is called when there is something to do; `captures` is for its workers."""

    graph: Graph
    store: Store
    package: str
    package_folder: Path
    make_executor: Callable[[], Executor]
    captures: bool
    tell: Callable[[Event], None]
    _done: dict[str, Done] = field(default_factory=dict)
    _ended: dict[str, State] = field(default_factory=dict)
    _running: dict[str, str] = field(default_factory=dict)
    _executor: Executor | None = None
    _commit: str | None = None
    _stopped_at: float | None = None

    def __post_init__(self) -> None:
        self._stop_flag = self.store.temporary()
        self._order = {name: index for index, name in enumerate(self.graph.nodes)}

    def run(self) -> Summary:
        """Runs everything; returns when nothing is left that can be done."""
        started = time.monotonic()
        try:
            with self._interruptible():
                self._loop()
        finally:
            if self._executor:
                self._executor.close()
            self._stop_flag.unlink(missing_ok=True)
        counts: Counter[State] = Counter(self._ended.values())
        summary = Summary(time.monotonic() - started, dict(counts), self._stopped_at is not None)
        self.tell(summary)
        return summary

    def reports(self) -> list[Path]:
        """The pages to open after a run: files of the `report` outputs of final stages, where `latest` shows them."""
        pages = []
        for name in self.graph.final:
            for output, port in self.graph.nodes[name].declaration.outputs.items():
                if port.kind == "report" and name in self._done:
                    files = self.store.artifact(self._done[name].outputs[output]).files
                    pages += [self.store.latest(self.graph.workflow, name, output) / file for file in files]
        return pages

    def _loop(self) -> None:
        waiting = list(self.graph.nodes)
        while waiting or self._running:
            if self._stopped_at is None:
                waiting = self._advance(waiting)
            elif not self._running or time.monotonic() - self._stopped_at > GRACE:
                for name in [*self._running, *waiting]:
                    self._end(name, "skipped", cause="the run was interrupted")
                return
            if self._running and self._executor:
                ended = self._executor.wait(self.tell, MOMENT)
                if ended:
                    self._take(*ended)

    def _advance(self, waiting: list[str]) -> list[str]:
        """Takes from the store or starts whatever can be; returns what still waits."""
        left: list[str] = []
        for index, name in enumerate(waiting):
            if self._stopped_at is not None:
                return [*left, *waiting[index:]]
            if not self._advance_one(name):
                left.append(name)
        return left

    def _advance_one(self, name: str) -> bool:
        node = self.graph.nodes[name]
        lacking = [upstream for upstream in node.upstream if self._ended.get(upstream) in ("failed", "skipped")]
        if lacking:
            self._end(name, "skipped", cause=f"needs {lacking[0]}, which was not made")
            return True
        if any(upstream not in self._done for upstream in node.upstream):
            return False
        digests: dict[Source, str | None] = {
            source: self._done[source.node].outputs[source.output]
            for sources in node.sources.values()
            for source in sources
        }
        parts = key_parts(node, digests)
        key = key_of(parts)
        record = self.store.find(key)
        if record:
            self._finish(node, key, record.outputs, "cached", 0.0)
            return True
        if key in self._running.values():
            return False  # another stage is just doing the same
        if self._running and (node.declaration.alone or self._someone_is_alone()):
            return False
        self._start(node, key, parts)
        return True

    def _someone_is_alone(self) -> bool:
        return any(self.graph.nodes[name].declaration.alone for name in self._running)

    def _job(self, node: Node, key: str, parts: Mapping[str, Json]) -> Job:
        return Job(
            name=node.name,
            workflow=self.graph.workflow,
            package=self.package,
            uses=node.uses,
            key=key,
            parts=parts,
            arguments=node.arguments,
            inputs={
                name: tuple(self._done[source.node].outputs[source.output] for source in sources)
                for name, sources in node.sources.items()
            },
            upstream=node.upstream,
            lineage=self._lineage(node),
            libraries=node.libraries,
            private=node.private,
            private_log=node.private or any(o.privacy == "private" for o in node.declaration.outputs.values()),
            store=self.store.root,
            stop_flag=self._stop_flag,
            commit=self._commit,
            captures=self.captures,
        )

    def _lineage(self, node: Node) -> dict[str, str]:
        """Keys of the actions behind a node by stage, in the order of the graph."""
        behind: dict[str, str] = {}
        for upstream in node.upstream:
            behind |= self._done[upstream].lineage
        return behind

    def _start(self, node: Node, key: str, parts: Mapping[str, Json]) -> None:
        if self._executor is None:
            self._commit = git_commit(self.package_folder)
            self._executor = self.make_executor()
        self._running[node.name] = key
        self._executor.start(node.name, perform, self._job(node, key, parts), urgency=-self._order[node.name])

    def _take(self, name: str, result: Outcome | Lost) -> None:
        node, key = self.graph.nodes[name], self._running.pop(name)
        log = self.store.log(self.graph.workflow, name)
        if isinstance(result, Lost):
            result = Outcome("failed", cause=result.reason)
        if result.state == "stopped":
            self._end(name, "skipped", seconds=result.seconds, cause=result.cause)
        elif result.outputs is None or result.state == "failed":
            self._end(name, "failed", key, result.seconds, result.cause or "failed", log)
        else:
            self._finish(node, key, result.outputs, "ran" if result.state == "ran" else "cached", result.seconds, log)

    def _finish(
        self, node: Node, key: str, outputs: Mapping[str, str], state: State, seconds: float, log: Path | None = None
    ) -> None:
        self._done[node.name] = Done(key, outputs, {**self._lineage(node), node.name: key})
        self.store.remember_result(self.graph.workflow, node.name, key)
        self.store.link_latest(self.graph.workflow, node.name, outputs)
        paths = {output: self.store.object(digest) for output, digest in outputs.items()}
        self._ended[node.name] = state
        self.tell(StageEnded(node.name, state, key, seconds, paths, None, log))

    def _end(
        self,
        name: str,
        state: State,
        key: str | None = None,
        seconds: float = 0.0,
        cause: str | None = None,
        log: Path | None = None,
    ) -> None:
        """Ends a node that has no outputs."""
        if state == "failed":
            last = self.store.last_result(self.graph.workflow, name)
            self.store.remember_result(self.graph.workflow, name, last["key"], failed=cause)
        self._ended[name] = state
        self.tell(StageEnded(name, state, key, seconds, {}, cause, log))

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """The first Ctrl-C asks running stages to stop, the second stops at once by KeyboardInterrupt."""

        def ask(number: int, frame: FrameType | None) -> None:
            if self._stopped_at is not None:
                raise KeyboardInterrupt
            self._stopped_at = time.monotonic()
            self._stop_flag.touch()
            with suppress(RuntimeError):  # Python refuses to print where the signal interrupted printing
                self.tell(Noted("stopping: running stages save what they have (Ctrl-C again stops at once)"))

        try:
            before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
        except ValueError:  # not the main thread: nothing is interrupted there
            before = {}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
