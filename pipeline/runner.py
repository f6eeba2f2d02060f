"""A run: what is in the store is taken from there, the rest is done as soon as what it takes is made.

The engine decides what may start, and the executor where: so a failed stage holds up nothing but what depends on it,
results that a dead worker held need not be made again, and a fully cached run starts no worker at all.
"""

from __future__ import annotations

import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
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
from pipeline.history import Journal, StageResult
from pipeline.provenance import git_commit
from pipeline.store import Record, Store

GRACE = 60.0  # seconds that a running stage has to save its checkpoint and stop
MOMENT = 0.2  # seconds between two looks at the stop flag
REPAIRS = 1  # times that one artifact is made again in one run


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
    _waiting: dict[str, None] = field(default_factory=dict)
    _damaged: Counter[str] = field(default_factory=Counter)
    _executor: Executor | None = None
    _journal: Journal | None = None
    _commit: str | None = None
    _stopped_at: float | None = None

    def __post_init__(self) -> None:
        self._stop_flag = self.store.temporary()
        self._order = {name: index for index, name in enumerate(self.graph.nodes)}
        self._final = frozenset(self.graph.final)
        self._dependents = self.graph.dependents

    def run(self) -> Summary:
        """Runs everything; returns when nothing is left that can be done. Raises CommandError during a `gc`."""
        started = time.monotonic()
        try:
            with self.store.in_use(), self._history(), self._interruptible():
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

    @contextmanager
    def _history(self) -> Iterator[None]:
        self._journal = self.store.history.begin(self.graph.workflow)
        try:
            yield
        finally:
            self._journal.close()

    def _loop(self) -> None:
        self.store.look(self.graph.workflow, self.graph.nodes.keys())
        self._waiting = dict.fromkeys(self.graph.nodes)
        candidates = list(self.graph.nodes)
        while self._waiting or self._running:
            if self._stopped_at is None:
                candidates = self._advance(candidates)
            elif not self._running or time.monotonic() - self._stopped_at > GRACE:
                for name in [*self._running, *self._waiting]:
                    self._end(StageResult(name, "skipped", cause="the run was interrupted"))
                return
            if self._running and self._executor:
                ended = self._executor.wait(self.tell, MOMENT)
                if ended:
                    candidates = self._in_order([*candidates, *self._take(*ended)])

    def _in_order(self, names: Iterable[str]) -> list[str]:
        return sorted(set(names) & self._waiting.keys(), key=self._order.__getitem__)

    def _advance(self, candidates: list[str]) -> list[str]:
        """Takes from the store or starts what can be; returns what is ready but has to wait for others to end."""
        held: list[str] = []
        queue = deque(candidates)
        queued = set(candidates)
        while queue and self._stopped_at is None:
            name = queue.popleft()
            queued.discard(name)
            if not self._advance_one(name):
                held.append(name)
            elif name in self._ended:
                concerned = [
                    other for other in self._dependents[name] if other in self._waiting and other not in queued
                ]
                queue.extend(concerned)
                queued.update(concerned)
        return [*held, *queue]

    def _advance_one(self, name: str) -> bool:
        """Does what can be done about a node; False where it is ready and held up by what runs."""
        node = self.graph.nodes[name]
        lacking = [upstream for upstream in node.upstream if self._ended.get(upstream) in ("failed", "skipped")]
        if lacking:
            self._end(StageResult(name, "skipped", cause=f"needs {lacking[0]}, which was not made"))
            return True
        if any(upstream not in self._done for upstream in node.upstream):
            return True  # it is looked at again when they end
        digests: dict[Source, str | None] = {
            source: self._done[source.node].outputs[source.output]
            for sources in node.sources.values()
            for source in sources
        }
        parts = key_parts(node, digests)
        key = key_of(parts)
        record = self._found(name, key)
        if record:
            self._finish(StageResult(name, "cached", key, record.outputs, 0.0, record.private))
            return True
        if key in self._running.values():
            return False  # another stage is just doing the same
        if self._running and (node.declaration.alone or self._someone_is_alone()):
            return False
        self._start(node, key, parts)
        return True

    def _found(self, name: str, key: str) -> Record | None:
        """The record of an action that is done. What the last stages made is at hand then, to be opened by people."""
        record = self.store.find(key)
        if record is None or name not in self._final:
            return record
        damaged = [digest for digest in record.outputs.values() if not self.store.is_whole(digest)]
        for digest in damaged:
            self.store.set_aside(digest)
        return None if damaged else record

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
            code=node.code,
            private=node.private,
            private_log=node.private or any(o.privacy == "private" for o in node.declaration.outputs.values()),
            store=self.store.address,
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
        del self._waiting[node.name]
        self._executor.start(node.name, perform, self._job(node, key, parts), urgency=-self._order[node.name])

    def _take(self, name: str, outcome: Outcome | Lost) -> Iterable[str]:
        """Ends what an executor is done with; returns the nodes that this may concern."""
        key = self._running.pop(name)
        if isinstance(outcome, Lost):
            outcome = Outcome("failed", cause=outcome.reason, log=self._log_of(name))
        if outcome.state == "damaged":
            return self._make_again(name, key, outcome)
        if outcome.state == "stopped":
            self._end(StageResult(name, "skipped", seconds=outcome.seconds, cause=outcome.cause))
        elif outcome.outputs is None or outcome.state == "failed":
            cause = outcome.cause or "failed"
            self._end(StageResult(name, "failed", key, {}, outcome.seconds, cause=cause), outcome.log)
        else:
            state: State = "ran" if outcome.state == "ran" else "cached"
            result = StageResult(name, state, key, outcome.outputs, outcome.seconds, outcome.private)
            self._finish(result, outcome.log)
        return self._dependents[name]

    def _make_again(self, name: str, key: str, outcome: Outcome) -> Iterable[str]:
        """Puts damaged inputs of a stage aside, and has what made them, and then the stage, done again."""
        self._damaged.update(outcome.damaged)
        hopeless = [digest for digest in outcome.damaged if self._damaged[digest] > REPAIRS]
        if hopeless:
            cause = f"{self.store.object(hopeless[0])}: damaged again after it was made anew. Check the disk."
            self._end(StageResult(name, "failed", key, cause=cause), outcome.log)
            return self._dependents[name]
        makers = [
            other for other, done in self._done.items() if not set(outcome.damaged).isdisjoint(done.outputs.values())
        ]
        for digest in outcome.damaged:
            self.store.set_aside(digest)
        for maker in makers:
            self.tell(Noted(f"{maker}: its result was damaged on the disk and is made again"))
            del self._done[maker], self._ended[maker]
        again = [*makers, name]
        self._waiting |= dict.fromkeys(again)
        return again

    def _log_of(self, name: str) -> Path | None:
        """The log that a worker left which died."""
        paths = [self.store.log(self.graph.workflow, name, private) for private in (False, True)]
        return next((path for path in paths if path.is_file()), None)

    def _finish(self, result: StageResult, log: Path | None = None) -> None:
        """Ends a node whose outputs are in the store."""
        node = self.graph.nodes[result.name]
        self._done[node.name] = Done(
            str(result.key), result.outputs, {**self._lineage(node), node.name: str(result.key)}
        )
        self.store.link_latest(self.graph.workflow, node.name, result.outputs)
        self._end(result, log)

    def _end(self, result: StageResult, log: Path | None = None) -> None:
        self._waiting.pop(result.name, None)
        self._ended[result.name] = result.state
        assert self._journal is not None
        self._journal.add(result)
        paths = {output: self.store.object(digest) for output, digest in result.outputs.items()}
        self.tell(StageEnded(result.name, result.state, result.key, result.seconds, paths, result.cause, log))

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
