"""A run: takes from the store what is there, and starts every other stage as soon as its inputs are made.

The engine decides what may start, and the executor where. So a failed stage holds up only what depends on it, a worker
that dies takes no finished results with it, and a fully cached run starts no worker at all.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.canonical import Json
from pipeline.disk import words_of
from pipeline.errors import Unreachable
from pipeline.events import Event, Noted, Remarked, StageEnded, StageState, Summary
from pipeline.plan.changes import FAILED
from pipeline.plan.keys import key_of, key_parts
from pipeline.plan.kindred import Kindred
from pipeline.plan.loss import last_of_their_kind, refusal, words_of_another
from pipeline.provenance import git_commit
from pipeline.run.action import Ancestor, Job, JobItem, Outcome, perform
from pipeline.run.cause import lasting_cause
from pipeline.run.executor import Executor, Lost
from pipeline.run.interruption import interruptible
from pipeline.run.urgency import urgencies
from pipeline.store.history import Journal, StageResult
from pipeline.store.record import Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, Node, Source

GRACE = 180.0  # seconds for running stages to save their checkpoints and stop: gigabytes take a minute or two
MOMENT = 0.2  # seconds to wait for work to end before looking again at whether to stop, or to try something again
REPAIRS = 1  # times that one artifact may be made again in one run
COMPLAINTS = 3  # times that one stage may find its inputs damaged in one run
RETRIES = 3  # times that a stage is retried after a transient error
FIRST_WAIT = 2.0  # seconds before the first retry; each further wait is four times as long


@dataclass(frozen=True)
class Done:
    """A node whose outputs are in the store; `lineage` holds all actions upstream, and last its own."""

    key: str
    outputs: Mapping[str, str]
    lineage: Mapping[str, Ancestor]


@dataclass
class Run:
    """One run of a graph. `make_executor` is called once there is something to do. For `captures`, see `Job`."""

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
        """Runs everything; returns when nothing is left that can be done.

        Raises CommandError during a `gc`, RemoteError if a bucket cannot be used, and KeyboardInterrupt when asked to
        stop a second time.
        """
        started, interrupted = time.monotonic(), False
        with interruptible(self._ask_to_stop):
            try:
                with self.store.in_use(), self._history():
                    self.store.sweep()
                    self._loop()
                    interrupted = self._stopped_at is not None  # afterwards there is nothing left to interrupt
            finally:
                if self._executor:
                    self._executor.close()
                self._stop_flag.unlink(missing_ok=True)
        counts: Counter[StageState] = Counter(self._ended.values())
        summary = Summary(time.monotonic() - started, dict(counts), interrupted)
        self.tell(summary)
        return summary

    def reports(self) -> list[Path]:
        """The pages to open after a run: files in the `report` outputs of final stages, by their paths in `latest`."""
        pages = []
        for name in self.graph.final:
            for output, port in self.graph.nodes[name].declaration.outputs.items():
                if port.kind == "report" and name in self._done:
                    files = self.store.artifact(self._done[name].outputs[output]).files
                    pages += [self.store.latest(self.graph.workflow, name, output) / file for file in files]
        return pages

    @contextmanager
    def _history(self) -> Iterator[None]:
        """Keeps a journal of the run if possible; a note says if it is not."""
        try:
            facts = {"whole": self.graph.whole, "stages": len(self.graph.nodes), "given": self.graph.given}
            self._journal = self.store.history.begin(self.graph.workflow, **facts)
        except OSError as error:
            self.tell(Noted(f"the history of this run cannot be kept: {words_of(error, self.store.root)}"))
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
        """Takes from the store, or starts, what it can; returns what is ready but has to wait for others to end."""
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
        """Does what can be done about a node; False if it is ready but has to wait."""
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
            self._held.add(name)  # another stage is doing the same, or one of them must run alone
            return False
        cause = refusal(node, key, parts, before, self.graph, self.store)
        if cause:
            self._causes[name] = lasting_cause(node, cause, self.store)
            self._end(StageResult(name, "failed", key, cause=cause))
        else:
            self._start(node, key, parts)
        return True

    def _found(self, name: str, key: str) -> Record | None:
        """The record of an action that is done, else None.

        Artifacts of final stages, which people open, are also checked (and fetched, from a bucket); damaged ones are
        set aside.
        """
        record = self.store.find(key)
        if record is None or name not in self._final:
            return record
        damaged = [digest for digest in record.outputs.values() if not self.store.is_whole(digest)]
        for digest in damaged:
            self.store.set_aside(digest)
        return None if damaged else record

    def _ask_again(self, name: str, error: Unreachable) -> None:
        """Has the store asked again after a while whether a stage is done: any number of times while others run.

        Raises the error if none runs, and the store was asked as often as a stage is retried.
        """
        if not self._running and self._failures[name] >= self.retries:
            raise error
        self._try_again(name, str(error))

    def _someone_is_alone(self) -> bool:
        return any(self.graph.nodes[name].declaration.alone for name in self._running)

    def _digest(self, source: Source) -> str | None:
        """The digest of an output of a stage that has ended; None if it failed."""
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
        """The actions upstream of a node, by stage, each after those that it took from."""
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
        """Deals with what the executor returned for a node; returns the nodes that may be affected."""
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
        """The outcome of an action whose worker is gone: it may be done; if not, it is retried unless it had begun.

        If the store cannot be asked, it counts as not done: the other stages go on.
        """
        record = None
        with suppress(Unreachable):
            record = self.store.find(key)
        if record:
            return Outcome("ran", record.seconds, record.outputs, private=record.private)
        log = self._log_of(name) if begun else None
        return Outcome("failed", cause=lost.reason, log=log, transient=lost.transient and not begun)

    def _try_again(self, name: str, cause: str | None) -> Iterable[str]:
        """Puts a stage back after a transient failure, to be tried again after a while."""
        times = min(self._failures[name] + 1, self.retries)
        wait = FIRST_WAIT * 4 ** (times - 1)
        self._failures[name] = times
        self._again_at[name] = time.monotonic() + wait
        self._waiting[name] = None
        self.tell(Noted(f"{name}: {cause}; trying again in {wait:.0f} s ({times} of {self.retries})"))
        return [name]

    def _begun_flag(self, key: str) -> Path:
        """The file that a worker creates when it begins an action of this run."""
        return self._stop_flag.with_name(f"{self._stop_flag.name}-{key}")

    def _make_again(self, name: str, key: str, outcome: Outcome) -> Iterable[str]:
        """Sets a stage's damaged inputs aside, and has the stages that made them, and then the stage itself, run again.

        If several stages or runs take the same artifact, the first that notices has it made again. Others may have
        begun before that, and complain later, when it is whole again or just being made. After `REPAIRS` or
        `COMPLAINTS` in one run, the stage fails.
        """
        damaged = {digest for digest in outcome.damaged if not self.store.is_sound(digest)}
        makers = [other for other, done in self._done.items() if not damaged.isdisjoint(done.outputs.values())]
        made_again = {digest for maker in makers for digest in self._done[maker].outputs.values()} & damaged
        self._damaged.update([name, *made_again])
        if self._damaged[name] > COMPLAINTS or any(self._damaged[digest] > REPAIRS for digest in made_again):
            cause = f"{self.store.object(outcome.damaged[0])}: damaged again after it was remade. Check the disk."
            self._causes[name] = lasting_cause(self.graph.nodes[name], cause, self.store)
            self._end(StageResult(name, "failed", key, cause=cause), outcome.log)
            return self._dependents[name]
        for digest in made_again:
            self.store.set_aside(digest)
        for maker in makers:
            aside = f"the damaged data is kept in {self.store.damaged.folder}"
            self.tell(Noted(f"{maker}: its result was damaged on the disk and has to be made again; {aside}"))
            del self._done[maker], self._ended[maker]
        again = [*makers, name]
        self._waiting |= dict.fromkeys(again)
        return again

    def _log_of(self, name: str) -> Path | None:
        """The log that a dead worker left; None if there is none."""
        paths = [self.store.log(self.graph.workflow, name, private) for private in (False, True)]
        return next((path for path in paths if path.is_file()), None)

    def _finish(self, result: StageResult, log: Path | None = None) -> None:
        """Ends a node whose outputs are in the store, and links them in `latest`."""
        node = self.graph.nodes[result.name]
        own = Ancestor(str(result.key), tuple(upstream for upstream in node.upstream if upstream in self._done))
        self._done[node.name] = Done(own.key, result.outputs, {**self._lineage(node), node.name: own})
        try:
            self.store.link_latest(self.graph.workflow, node.name, result.outputs)
        except OSError as error:
            self.tell(Noted(f"{node.name}: cannot link to its result: {words_of(error, self.store.root)}"))
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
        """Removes a stage's links: what an earlier run made of other inputs must not pass for this run's result."""
        for output in self.graph.nodes[name].declaration.outputs:
            with suppress(OSError):
                self.store.unlink_latest(f"{self.graph.workflow}/{name}.{output}")

    def _ask_to_stop(self) -> None:
        """Asks running stages to stop; raises KeyboardInterrupt the second time, which stops the run at once."""
        if self._stopped_at is not None:
            raise KeyboardInterrupt
        self._stopped_at = time.monotonic()
        with suppress(OSError):  # a full disk, on which no checkpoint could be saved either
            self._stop_flag.touch()
        with suppress(RuntimeError, OSError):  # the signal interrupted printing, or the terminal is gone
            self.tell(Noted("stopping: running stages save what they have (Ctrl-C again stops at once)"))
