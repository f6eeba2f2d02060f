"""A run: what is in the store is taken from there, the rest is done as soon as what it takes is made.

The engine decides what may start, and the executor where: so a failed stage holds up nothing but what depends on it,
results that a dead worker held need not be made again, and a fully cached run starts no worker at all.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.action import Ancestor, Job, JobItem, Outcome, perform
from pipeline.canonical import Json
from pipeline.cause import lasting_cause
from pipeline.changes import FAILED
from pipeline.disk import words_of
from pipeline.errors import Unreachable
from pipeline.events import Event, Noted, Remarked, StageEnded, StageState, Summary
from pipeline.executor import Executor, Lost
from pipeline.graph import Graph, Node, Source
from pipeline.history import Journal, StageResult
from pipeline.interruption import interruptible
from pipeline.keys import key_of, key_parts
from pipeline.kindred import Kindred
from pipeline.loss import last_of_their_kind, refusal, words_of_another
from pipeline.provenance import git_commit
from pipeline.record import Record
from pipeline.store import Store
from pipeline.urgency import urgencies

GRACE = 180.0  # seconds that a running stage has to save its checkpoint and stop: gigabytes take a minute or two
MOMENT = 0.2  # seconds between two looks at the stop flag
REPAIRS = 1  # times that one artifact is made again in one run
COMPLAINTS = 3  # times that one stage finds its inputs damaged in one run
RETRIES = 3  # times that a stage is tried again whose error may pass
FIRST_WAIT = 2.0  # seconds before it is tried again; each time four times as long


@dataclass(frozen=True)
class Done:
    """A node whose outputs are in the store; `lineage` holds all actions behind it and its own."""

    key: str
    outputs: Mapping[str, str]
    lineage: Mapping[str, Ancestor]


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
    retries: int = RETRIES
    _done: dict[str, Done] = field(default_factory=dict)
    _ended: dict[str, StageState] = field(default_factory=dict)
    _running: dict[str, str] = field(default_factory=dict)
    _waiting: dict[str, None] = field(default_factory=dict)
    _causes: dict[str, str] = field(default_factory=dict)
    _damaged: Counter[str] = field(default_factory=Counter)
    _executor: Executor | None = None
    _journal: Journal | None = None
    _failures: Counter[str] = field(default_factory=Counter)
    _again_at: dict[str, float] = field(default_factory=dict)
    _held: set[str] = field(default_factory=set)
    _commit: str | None = None
    _stopped_at: float | None = None

    def __post_init__(self) -> None:
        self._stop_flag = self.store.temporary()
        self._order = {name: index for index, name in enumerate(self.graph.nodes)}
        self._urgencies = urgencies(self.graph)
        self._final = frozenset(self.graph.final)
        self._dependents = self.graph.dependents
        self._before = last_of_their_kind(self.graph, self.store)
        self._kindred = Kindred(self.graph.workflow, self.store)

    def run(self) -> Summary:
        """Runs everything; returns when nothing is left that can be done. Raises CommandError during a `gc`."""
        started, interrupted = time.monotonic(), False
        with interruptible(self._ask_to_stop):
            try:
                with self.store.in_use(), self._history():
                    self.store.sweep()
                    self._loop()
                    interrupted = self._stopped_at is not None  # later there is nothing left to interrupt
            finally:
                if self._executor:
                    self._executor.close()
                self._stop_flag.unlink(missing_ok=True)
        counts: Counter[StageState] = Counter(self._ended.values())
        summary = Summary(time.monotonic() - started, dict(counts), interrupted)
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
        """Keeps a journal where one can be kept."""
        try:
            facts = {"whole": self.graph.whole, "stages": len(self.graph.nodes), "given": self.graph.given}
            self._journal = self.store.history.begin(self.graph.workflow, **facts)
        except OSError as error:
            self.tell(Noted(f"no history is kept of this run: {words_of(error, self.store.root)}"))
        try:
            yield
            if self._journal and self._stopped_at is None:
                self._journal.end()
        finally:
            if self._journal:
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
            elif self._again_at:
                time.sleep(MOMENT)

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
        if any(upstream not in self._ended for upstream in node.upstream):
            return True  # it is looked at again when they end
        lacking = [upstream for upstream in node.required if upstream not in self._done]
        if lacking:
            self._causes[name] = self._causes.get(lacking[0], "not made")
            self._end(StageResult(name, "skipped", cause=f"needs {lacking[0]}, which was not made"))
            return True
        if time.monotonic() < self._again_at.get(name, 0.0) or name in self._held:
            return False
        digests = {source: self._digest(source) for sources in node.sources.values() for source in sources}
        parts = key_parts(node, {source: digest or FAILED for source, digest in digests.items()}, self._causes)
        key = key_of(parts)
        try:
            record = self._found(name, key)
            is_drawn = node.unrepeatable and record is None
            before = self._kindred.before(node, key, parts, self._before.get(name)) if is_drawn else None
        except Unreachable as error:
            self._ask_again(name, error)
            return False
        if record:
            self._again_at.pop(name, None)
            self._finish(StageResult(name, "cached", key, record.outputs, 0.0, record.private))
            return True
        if key in self._running.values() or (self._running and (node.declaration.alone or self._someone_is_alone())):
            self._held.add(name)  # another stage is just doing the same, or one of them has to be alone
            return False
        cause = refusal(node, key, parts, before, self.graph, self.store)
        if cause:
            self._causes[name] = lasting_cause(node, cause, self.store)
            self._end(StageResult(name, "failed", key, cause=cause))
        else:
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

    def _ask_again(self, name: str, error: Unreachable) -> None:
        """Whether a stage is done is asked again after a while: however often, as long as others work meanwhile.

        Raises the error where none does, and it was asked as often as a stage is tried.
        """
        if not self._running and self._failures[name] >= self.retries:
            raise error
        self._try_again(name, str(error))

    def _someone_is_alone(self) -> bool:
        return any(self.graph.nodes[name].declaration.alone for name in self._running)

    def _digest(self, source: Source) -> str | None:
        """The artifact of a stage that ended; None where it failed."""
        return self._done[source.node].outputs[source.output] if source.node in self._done else None

    def _job(self, node: Node, key: str, parts: Mapping[str, Json]) -> Job:
        return Job(
            name=node.name,
            workflow=self.graph.workflow,
            command=self.graph.command,
            package=self.package,
            uses=node.uses,
            key=key,
            parts=parts,
            arguments=node.arguments,
            inputs={
                name: tuple(digest for digest in map(self._digest, sources) if digest)
                for name, sources in node.sources.items()
            },
            items={
                name: tuple(
                    JobItem(label.text, label.values, source.node, self._digest(source), self._causes.get(source.node))
                    for label, source in zip(labels, node.sources[name], strict=True)
                )
                for name, labels in node.labels.items()
            },
            upstream=tuple(upstream for upstream in node.upstream if upstream in self._done),
            lineage=self._lineage(node),
            code=node.code,
            private=node.private,
            private_log=node.private or any(o.privacy == "private" for o in node.declaration.outputs.values()),
            store=self.store.address,
            stop_flag=self._stop_flag,
            begun_flag=self._begun_flag(key),
            commit=self._commit,
            captures=self.captures,
        )

    def _lineage(self, node: Node) -> dict[str, Ancestor]:
        """The actions behind a node by stage, in the order of the graph."""
        behind: dict[str, Ancestor] = {}
        for upstream in node.upstream:
            behind |= self._done[upstream].lineage if upstream in self._done else {}
        return behind

    def _start(self, node: Node, key: str, parts: Mapping[str, Json]) -> None:
        if self._executor is None:
            self._commit = git_commit(self.package_folder)
            self._executor = self.make_executor()
        another = words_of_another(node, key, self._before.get(node.name), self.graph)
        if another and not self._failures[node.name]:
            self.tell(Noted(another))
        if self._journal:
            self._journal.begin(key)
        self._running[node.name] = key
        del self._waiting[node.name]
        self._again_at.pop(node.name, None)
        job = self._job(node, key, parts)
        self._executor.start(node.name, perform, job, self._urgencies[node.name], node.resources)

    def _take(self, name: str, outcome: Outcome | Lost) -> Iterable[str]:
        """Ends what an executor is done with; returns the nodes that this may concern."""
        key = self._running.pop(name)
        self._held.clear()
        begun = self._begun_flag(key)
        if isinstance(outcome, Lost):
            outcome = self._lost(name, key, outcome, begun.exists())
        begun.unlink(missing_ok=True)
        if outcome.transient and self._failures[name] < self.retries and self._stopped_at is None:
            return self._try_again(name, outcome.cause)
        if outcome.state == "damaged":
            return self._make_again(name, key, outcome)
        if outcome.state == "stopped":
            self._end(StageResult(name, "skipped", seconds=outcome.seconds, cause=outcome.cause))
        elif outcome.outputs is None or outcome.state == "failed":
            cause = outcome.cause or "failed"
            self._causes[name] = lasting_cause(self.graph.nodes[name], cause, self.store)
            self._end(StageResult(name, "failed", key, {}, outcome.seconds, cause=cause), outcome.log)
        else:
            state: StageState = "ran" if outcome.state == "ran" else "cached"
            result = StageResult(name, state, key, outcome.outputs, outcome.seconds, outcome.private)
            self._finish(result, outcome.log)
            for remark in outcome.remarks:
                self.tell(Remarked(name, remark.text, outcome.log if remark.details else None, remark.as_wished))
        return self._dependents[name]

    def _lost(self, name: str, key: str, lost: Lost, begun: bool) -> Outcome:
        """What came of an action whose worker is gone: perhaps it was done; else, if it began, it is not repeated."""
        record = self.store.find(key)
        if record:
            return Outcome("ran", record.seconds, record.outputs, private=record.private)
        log = self._log_of(name) if begun else None
        return Outcome("failed", cause=lost.reason, log=log, transient=lost.transient and not begun)

    def _try_again(self, name: str, cause: str | None) -> Iterable[str]:
        """Puts a stage back whose failure may pass, to be done after a while."""
        times = min(self._failures[name] + 1, self.retries)
        wait = FIRST_WAIT * 4 ** (times - 1)
        self._failures[name] = times
        self._again_at[name] = time.monotonic() + wait
        self._waiting[name] = None
        self.tell(Noted(f"{name}: {cause}; tried again in {wait:.0f} s ({times} of {self.retries})"))
        return [name]

    def _begun_flag(self, key: str) -> Path:
        """What a worker makes when it begins an action of this run."""
        return self._stop_flag.with_name(f"{self._stop_flag.name}-{key}")

    def _make_again(self, name: str, key: str, outcome: Outcome) -> Iterable[str]:
        """Puts damaged inputs of a stage aside, and has what made them, and then the stage, done again.

        Of several stages that take the same one, or several runs, the first that notices has it made again; others may
        have begun before that and complain later, when it is whole again or just being made.
        """
        damaged = {digest for digest in outcome.damaged if not self.store.is_sound(digest)}
        makers = [other for other, done in self._done.items() if not damaged.isdisjoint(done.outputs.values())]
        made_again = {digest for maker in makers for digest in self._done[maker].outputs.values()} & damaged
        self._damaged.update([name, *made_again])
        if self._damaged[name] > COMPLAINTS or any(self._damaged[digest] > REPAIRS for digest in made_again):
            cause = f"{self.store.object(outcome.damaged[0])}: damaged again after it was made anew. Check the disk."
            self._causes[name] = lasting_cause(self.graph.nodes[name], cause, self.store)
            self._end(StageResult(name, "failed", key, cause=cause), outcome.log)
            return self._dependents[name]
        for digest in made_again:
            self.store.set_aside(digest)
        for maker in makers:
            aside = f"what is damaged is kept in {self.store.damaged.folder}"
            self.tell(Noted(f"{maker}: its result was damaged on the disk and has to be made again; {aside}"))
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
        own = Ancestor(str(result.key), tuple(upstream for upstream in node.upstream if upstream in self._done))
        self._done[node.name] = Done(own.key, result.outputs, {**self._lineage(node), node.name: own})
        try:
            self.store.link_latest(self.graph.workflow, node.name, result.outputs)
        except OSError as error:
            self.tell(Noted(f"{node.name}: no link to its result: {words_of(error, self.store.root)}"))
        self._end(result, log)

    def _end(self, result: StageResult, log: Path | None = None) -> None:
        self._waiting.pop(result.name, None)
        self._ended[result.name] = result.state
        if result.state == "failed" or (result.state == "skipped" and self._stopped_at is None):
            self._forget_latest(result.name)
        if self._journal:
            self._journal.add(result)
        paths = {output: self.store.object(digest) for output, digest in result.outputs.items()}
        self.tell(StageEnded(result.name, result.state, result.key, result.seconds, paths, result.cause, log))

    def _forget_latest(self, name: str) -> None:
        """What a stage made in a run before, of other inputs, is not taken for the result of this one."""
        for output in self.graph.nodes[name].declaration.outputs:
            with suppress(OSError):
                self.store.unlink_latest(f"{self.graph.workflow}/{name}.{output}")

    def _ask_to_stop(self) -> None:
        """At first, running stages are asked to stop; asked a second time, it stops at once by KeyboardInterrupt."""
        if self._stopped_at is not None:
            raise KeyboardInterrupt
        self._stopped_at = time.monotonic()
        with suppress(OSError):  # a full disk: there is no checkpoint to be saved either
            self._stop_flag.touch()
        with suppress(RuntimeError, OSError):  # printing was interrupted to come here, or the terminal is gone
            self.tell(Noted("stopping: running stages save what they have (Ctrl-C again stops at once)"))
