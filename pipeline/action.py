"""One action, done where a worker is: look again under the lock, run the stage, commit what it made.

It never raises for what a stage does wrong: the outcome says what happened, in words, and the log holds the rest.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from filelock import Timeout

from pipeline.artifact import ArtifactWriter
from pipeline.canonical import Json
from pipeline.checkpoint import discard_scratch, scratch_directory
from pipeline.declaration import import_stage, validate
from pipeline.errors import Interrupted, PipelineError
from pipeline.events import Noted, StageProgressed, StageStarted
from pipeline.executor import Tell
from pipeline.provenance import machine, now, versions_of
from pipeline.stage import Context, InputValue, LineageRecord, Services, Stage, bind_inputs, output_is_private
from pipeline.stagelog import StageLog, printed_to_stderr
from pipeline.store import Record, Store

TELL_EVERY = 0.25  # seconds between two messages about progress
LOOK_EVERY = 0.2  # seconds between two looks at the stop flag
LONGEST_CAUSE = 500  # characters


@dataclass(frozen=True)
class Job:
    """All that a worker must know to do one action.

    `inputs` holds the digests of the artifacts of each input; `lineage` the key of every action upstream by the name
    of its stage, in order; `stop_flag` is a file that appears when work should stop. `private` is what the workflow
    says; `private_log` whether an output is declared private. `captures` sends what the process prints to the log, for
    processes that are a worker's own.
    """

    name: str
    workflow: str
    package: str
    uses: str
    key: str
    parts: Mapping[str, Json]
    arguments: Mapping[str, Json]
    inputs: Mapping[str, tuple[str, ...]]
    upstream: tuple[str, ...]
    lineage: Mapping[str, str]
    libraries: tuple[str, ...]
    private: bool
    private_log: bool
    store: Path
    stop_flag: Path
    commit: str | None
    captures: bool


@dataclass(frozen=True)
class Outcome:
    """How an action ended. `outputs` are digests; `cause` says in one line why it did not end well."""

    state: Literal["ran", "cached", "failed", "stopped"]
    seconds: float = 0.0
    outputs: Mapping[str, str] | None = None
    cause: str | None = None


def perform(job: Job, tell: Tell) -> Outcome:
    """Does the action of `job`, unless it is done already or all is to stop."""
    store = Store(job.store)
    lock = store.lock(job.key)
    waits = False
    while not job.stop_flag.exists():
        try:
            lock.acquire(timeout=LOOK_EVERY)
        except Timeout:
            if not waits:
                tell(Noted(f"{job.name} waits for another run that is doing the same"))
            waits = True
            continue
        try:
            record = store.find(job.key)
            return Outcome("cached", outputs=record.outputs) if record else _logged(job, store, tell)
        finally:
            lock.release()
    return Outcome("stopped", cause="stopped before it began")


def _logged(job: Job, store: Store, tell: Tell) -> Outcome:
    """Runs the stage with its log, and turns whatever it raises into an outcome."""
    started = time.monotonic()
    work = store.temporary()
    log = StageLog(store.log(job.workflow, job.name), job.private_log)
    log.line(f"{job.name} ({job.uses}), key {job.key}, commit {job.commit or 'unknown'}")
    tell(StageStarted(job.name))
    try:
        with log.captured() if job.captures else printed_to_stderr():
            record = _Action(job, store, log, tell).run(work)
        log.line(f"done in {record.seconds:.1f} s")
        return Outcome("ran", record.seconds, record.outputs)
    except Interrupted:
        log.line("stopped")
        return Outcome("stopped", time.monotonic() - started, cause="stopped; it goes on from its checkpoint next time")
    except (Exception, SystemExit) as error:
        log.traceback()
        return Outcome("failed", time.monotonic() - started, cause=_cause(error))
    finally:
        log.close()
        shutil.rmtree(work, ignore_errors=True)


class _Action:
    """A stage at work, and what the engine does for it meanwhile."""

    def __init__(self, job: Job, store: Store, log: StageLog, tell: Tell) -> None:
        self.job = job
        self.store = store
        self.log = log
        self.tell = tell
        self.told = self.looked = 0.0
        self.stopping = False

    def run(self, work: Path) -> Record:
        job, began, started = self.job, now(), time.monotonic()
        declared = import_stage(job.package, job.uses)
        parameters = validate(declared, job.arguments)
        inputs, private = self.inputs(declared)
        if private:
            self.log.make_private()
        writers = {
            name: ArtifactWriter(work / name, output.kind, output_is_private(output, private))
            for name, output in declared.outputs.items()
        }
        services = Services(self.progress, self.log.line, self.stop_requested, self.lineage)
        context = Context(inputs, writers, scratch_directory(self.store, job.key), job.workflow, services)
        declared(context, parameters)
        provenance = {
            "name": job.name,
            "workflow": job.workflow,
            "upstream": list(job.upstream),
            "started": began,
            "seconds": round(time.monotonic() - started, 3),
            "versions": versions_of(job.libraries),
            "machine": machine(),
            "facts": context.facts,
            "commit": job.commit,
            "private": private or any(writer.private for writer in writers.values()),
        }
        record = self.store.commit(job.key, job.parts, writers, provenance)
        discard_scratch(self.store, job.key)
        return record

    def inputs(self, declared: Stage) -> tuple[dict[str, InputValue], bool]:
        """The artifacts of every input, and whether what comes from them is private."""
        given: dict[str, InputValue] = {}
        private = self.job.private
        for name, digests in self.job.inputs.items():
            artifacts = tuple(self.store.artifact(digest) for digest in digests)
            private = private or any(artifact.private for artifact in artifacts)
            if artifacts:
                given[name] = artifacts if declared.inputs[name].many else artifacts[0]
        return bind_inputs(declared, given), private

    def progress(self, done: float, total: float, figures: Mapping[str, float]) -> None:
        moment = time.monotonic()
        if moment - self.told >= TELL_EVERY or done >= total:
            self.told = moment
            numbers = {name: float(value) for name, value in figures.items()}
            self.tell(StageProgressed(self.job.name, float(done), float(total), numbers))

    def stop_requested(self) -> bool:
        moment = time.monotonic()
        if moment - self.looked >= LOOK_EVERY:
            self.looked = moment
            self.stopping = self.job.stop_flag.exists()
        return self.stopping

    def lineage(self) -> tuple[LineageRecord, ...]:
        return read_lineage(self.store, self.job.lineage)


def read_lineage(store: Store, keys: Mapping[str, str]) -> tuple[LineageRecord, ...]:
    """What the store knows of the actions `keys`, given by the names that their stages have in this workflow."""
    records = []
    for name, key in keys.items():
        record = store.record(key)
        if record is None:
            continue
        provenance: Mapping[str, Any] = record.provenance
        parts: Mapping[str, Any] = record.parts
        records.append(
            LineageRecord(
                name=name,
                uses=parts["stage"],
                seconds=record.seconds,
                inputs=tuple(provenance["upstream"]),
                facts={**provenance["machine"], **provenance["facts"]},
                versions=provenance["versions"],
                parameters=parts["parameters"],
                private=provenance["private"],
            )
        )
    return tuple(records)


def _cause(error: BaseException) -> str:
    """One line for a person: our own messages as they are, others with their type."""
    lines = str(error).strip().splitlines() or [""]
    if isinstance(error, PipelineError):
        return " ".join(line.strip() for line in lines)
    return f"{type(error).__name__}: {lines[0]}"[:LONGEST_CAUSE]
