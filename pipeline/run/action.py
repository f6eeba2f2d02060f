"""One action, performed by a worker: look for it in the store again under its lock, run the stage, commit its outputs.

An error of the stage is never raised: the outcome says in words what happened, and the log holds the rest. A damaged
input is not the stage's failure: the outcome names it, and the run makes it again.
"""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

from filelock import Timeout

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.canonical import Json
from pipeline.checkpoint import discard_scratch, scratch_directory
from pipeline.code.declaration import check_completed, external_paths, import_stage, is_unrepeatable, validate
from pipeline.code.fingerprint import Code
from pipeline.code.loaded_code import LoadedCode
from pipeline.disk import bytes_below, leads_elsewhere
from pipeline.errors import CorruptArtifact, Interrupted, PipelineError, TransientError, UserError
from pipeline.events import Noted, StageProgressed, StageStarted
from pipeline.provenance import machine, now, versions_of
from pipeline.run.cause import cause_of
from pipeline.run.executor import Tell
from pipeline.run.process import nobody_else_reads
from pipeline.run.remarks import remarks_on
from pipeline.stage import (
    Context,
    Finished,
    InputValue,
    Item,
    LineageRecord,
    Remark,
    Services,
    Stage,
    bind_inputs,
    output_is_private,
)
from pipeline.store.external_cache import ExternalCache
from pipeline.store.opening import open_store
from pipeline.store.record import Record
from pipeline.store.stage_log import StageLog, printed_to_stderr
from pipeline.store.store import Store

TELL_EVERY = 0.25  # seconds between two progress events
LOOK_EVERY = 0.2  # seconds between two checks of the stop flag


@dataclass(frozen=True)
class Ancestor:
    """An action in the lineage of an artifact; `upstream` names the stages whose artifacts it took."""

    key: str
    upstream: tuple[str, ...]


@dataclass(frozen=True)
class JobItem:
    """What one artifact of a labelled input is about. If its stage failed, `digest` is None and `cause` says why."""

    label: str
    values: Mapping[str, Json]
    stage: str
    digest: str | None
    cause: str | None


@dataclass(frozen=True)
class Job:
    """Everything that a worker needs to perform one action.

    `command` runs the workflow in the same way again. `inputs` holds the digests of each input's artifacts, `items`
    what the artifacts of labelled inputs are about, and `lineage` every action upstream by stage name, in order.
    `store` is the address of the store. The worker stops when the file `stop_flag` appears, and creates the file
    `begun_flag` when the stage begins: without it, a worker that died has done nothing. `private` is the workflow's
    setting; `private_log` is true if the stage or any of its outputs is declared private. `captures` sends the
    process's output to the log, in processes that are a worker's own.
    """

    name: str
    workflow: str
    command: str
    package: str
    uses: str
    key: str
    parts: Mapping[str, Json]
    arguments: Mapping[str, Json]
    inputs: Mapping[str, tuple[str, ...]]
    items: Mapping[str, tuple[JobItem, ...]]
    upstream: tuple[str, ...]
    lineage: Mapping[str, Ancestor]
    code: Code
    private: bool
    private_log: bool
    store: str
    stop_flag: Path
    begun_flag: Path
    commit: str | None
    captures: bool

    @property
    def digests(self) -> tuple[str, ...]:
        """The digests of all inputs, each once."""
        return tuple(dict.fromkeys(digest for digests in self.inputs.values() for digest in digests))


@dataclass(frozen=True)
class Outcome:
    """How an action ended. `outputs` holds digests; `cause` says in one line why it did not end well.

    `damaged` holds the digests of damaged inputs. `private` says whether an output is private, `transient` whether a
    retry may succeed. `remarks` are what a person should know about the result.
    """

    state: Literal["ran", "cached", "failed", "stopped", "damaged"]
    seconds: float = 0.0
    outputs: Mapping[str, str] | None = None
    cause: str | None = None
    damaged: tuple[str, ...] = ()
    private: bool = False
    log: Path | None = None
    transient: bool = False
    remarks: tuple[Remark, ...] = ()


def perform(job: Job, tell: Tell) -> Outcome:
    """Performs the action of `job`, unless it is already done or the run is to stop.

    An OSError or PipelineError outside the stage becomes an outcome, too.
    """
    try:
        return _perform(job, tell)
    except (OSError, PipelineError) as error:  # outside the stage: no lock, no log, no input fetched, or `gc` at work
        return Outcome("failed", cause=cause_of(error, job.store), transient=isinstance(error, TransientError))


def _perform(job: Job, tell: Tell) -> Outcome:
    store = open_store(job.store)
    lock = store.lock(job.key)
    waits = False
    while not job.stop_flag.exists():
        try:
            lock.acquire(timeout=LOOK_EVERY)
        except Timeout:
            if not waits:
                tell(Noted(f"{job.name} is waiting for another run that is doing the same work"))
            waits = True
            continue
        try:
            record = store.find(job.key) or store.send_late(job.key)
            if record:
                return Outcome("cached", outputs=record.outputs, private=record.private)
            with store.in_use():
                return _with_inputs(job, store, tell)
        finally:
            lock.release()
    return Outcome("stopped", cause="stopped before it began")


def _with_inputs(job: Job, store: Store, tell: Tell) -> Outcome:
    """Opens the inputs and runs the stage, unless an input is damaged."""
    artifacts: dict[str, Artifact] = {}
    for digest in job.digests:
        with suppress(CorruptArtifact):
            artifact = store.artifact(digest)
            artifact.check_sizes()
            artifacts[digest] = artifact
    damaged = tuple(digest for digest in job.digests if digest not in artifacts)
    if damaged:
        return Outcome("damaged", damaged=damaged)
    inputs = {name: tuple(artifacts[digest] for digest in digests) for name, digests in job.inputs.items()}
    private = job.private or any(artifact.private for group in inputs.values() for artifact in group)
    return _logged(job, store, tell, _Action(job, store, inputs, private))


def _logged(job: Job, store: Store, tell: Tell, action: _Action) -> Outcome:
    """Runs the stage with its log, and turns whatever it raises into an outcome."""
    started = time.monotonic()
    work = store.temporary()
    private = action.private or job.private_log
    path = store.log(job.workflow, job.name, private)
    if leads_elsewhere(store.root, "logs", job.workflow, "private"):
        raise OSError(errno.ELOOP, "a link; expected a folder", str(path.parent))
    store.log(job.workflow, job.name, not private).unlink(missing_ok=True)
    log = StageLog(path, private)
    log.head(job.name, job.uses, job.key, job.commit)
    with suppress(OSError):  # on another machine, a bucket's mirror is elsewhere, and so are its flags
        job.begun_flag.touch()
    tell(StageStarted(job.name))
    try:
        with log.captured() if job.captures else printed_to_stderr():
            record = action.run(work, log, tell)
        log.line(f"done in {record.seconds:.1f} s")
        made = Outcome("ran", record.seconds, record.outputs, private=record.private, log=path)
        return replace(made, remarks=action.remarks(record, log))
    except Interrupted as interrupted:
        cause = "; ".join(filter(None, (str(interrupted) or "stopped", action.unsaved)))
        log.line(cause)
        return Outcome("stopped", time.monotonic() - started, cause=cause, log=path)
    except (Exception, SystemExit) as error:
        log.traceback()
        damaged = action.damaged_inputs(error) if isinstance(error, CorruptArtifact) else ()
        state: Literal["damaged", "failed"] = "damaged" if damaged else "failed"
        cause = cause_of(error, store.root, bytes_below(work))
        transient = isinstance(error, TransientError)
        return Outcome(state, time.monotonic() - started, None, cause, damaged, log=path, transient=transient)
    finally:
        action.loaded.look()  # a stage that failed early, or its remarks, may have loaded modules for later stages
        log.close()
        store.keep_log(path)
        shutil.rmtree(work, ignore_errors=True)


class _Action:
    """A running stage, and what the engine does for it."""

    def __init__(self, job: Job, store: Store, given: Mapping[str, tuple[Artifact, ...]], private: bool) -> None:
        self.job = job
        self.store = store
        self.given = given
        self.private = private
        self.loaded = LoadedCode(job.code)
        self.told = self.looked = 0.0
        self.stopping = False
        self.unsaved = ""

    def run(self, work: Path, log: StageLog, tell: Tell) -> Record:
        """Runs the stage and commits its outputs. Raises whatever the stage raises."""
        job, began, started = self.job, now(), time.monotonic()
        work.mkdir(mode=0o700)
        declared = import_stage(job.package, job.uses)
        self.loaded.check()
        parameters = validate(declared, job.arguments)
        check_completed(declared, parameters, cast(Mapping[str, Json], job.parts["parameters"]))
        inputs = self.inputs(declared)
        writers = {
            name: ArtifactWriter(work / name, output.kind, output_is_private(output, self.private, job.private))
            for name, output in declared.outputs.items()
        }
        progress, saved = partial(self.progress, tell), partial(self.saved, tell)
        services = Services(progress, log.line, self.stop_requested, self.lineage, job.command, saved)
        scratch = scratch_directory(self.store, job.key)
        context = Context(inputs, writers, scratch, job.workflow, services, self.items())
        with nobody_else_reads():
            declared(context, parameters)
        self.loaded.check()
        self.check_external(external_paths(parameters))
        provenance = {
            "name": job.name,
            "workflow": job.workflow,
            "upstream": list(job.upstream),
            "started": began,
            "seconds": round(context.seconds_before + time.monotonic() - started, 3),
            "versions": versions_of(job.code.libraries),
            "machine": machine(),
            "facts": context.facts,
            "commit": job.commit,
            "private": self.private or any(writer.private for writer in writers.values()),
            **({"unrepeatable": True} if is_unrepeatable(declared, parameters) else {}),
            "from_accepted": from_accepted(self.store, {name: job.lineage[name].key for name in job.upstream}),
        }
        record = self.store.commit(job.key, job.parts, writers, provenance)
        discard_scratch(self.store, job.key)
        return record

    def inputs(self, declared: Stage) -> dict[str, InputValue]:
        """The artifacts of every input, as the stage takes them.

        Raises UserError if an input that may lack failed ones, and does not say which failed, lost all of them.
        """
        for name, artifacts in self.given.items():
            if not artifacts and name not in self.job.items and not declared.inputs[name].optional:
                raise UserError(f"everything failed that is taken as {name!r}", remedy="What failed says why.")
        given: dict[str, InputValue] = {
            name: artifacts if declared.inputs[name].many else artifacts[0]
            for name, artifacts in self.given.items()
            if artifacts or name in self.job.items
        }
        return bind_inputs(declared, given)

    def remarks(self, record: Record, log: StageLog) -> tuple[Remark, ...]:
        """The stage's remarks on the result, also written to the log in full; none if making them fails."""
        try:
            declared = import_stage(self.job.package, self.job.uses)
            outputs = {name: self.store.artifact(digest) for name, digest in record.outputs.items()}
            said = remarks_on(declared, Finished(self.inputs(declared), outputs, record.provenance["facts"]))
        except Exception:
            log.traceback()
            return ()
        for remark in said:
            log.line(" ".join(filter(None, (remark.text, remark.details))))
        return said

    def check_external(self, external: Mapping[str, tuple[str, ...]]) -> None:
        """Raises UserError if one of the paths that the stage may have read has changed since the run was planned."""
        planned: Any = self.job.parts["external"]
        cache = ExternalCache(self.store)
        for name, paths in external.items():
            for path, digest in zip(paths, planned[name], strict=True):
                if digest and cache.digest(Path(path)) != digest:  # "": a default that led nowhere
                    raise UserError("changed since the run began", where=path, remedy="Run again.")

    def items(self) -> dict[str, tuple[Item, ...]]:
        """What the artifacts of labelled inputs are about."""
        artifacts = {artifact.digest: artifact for group in self.given.values() for artifact in group}
        return {
            name: tuple(
                Item(item.label, item.values, item.stage, artifacts.get(item.digest or ""), item.cause)
                for item in items
            )
            for name, items in self.job.items.items()
        }

    def damaged_inputs(self, error: CorruptArtifact) -> tuple[str, ...]:
        """Digests of the inputs that are damaged; reads every byte of all of them.

        If all are sound, another run has just made them again: then the digests of those that the error mentions.
        """
        damaged = tuple(digest for digest in self.job.digests if not self.store.is_sound(digest))
        return damaged or tuple(digest for digest in self.job.digests if digest in str(error))

    def progress(self, tell: Tell, done: float, total: float, figures: Mapping[str, float]) -> None:
        moment = time.monotonic()
        if moment - self.told >= TELL_EVERY or done >= total:
            self.told = moment
            self.loaded.look()
            numbers = {name: float(value) for name, value in figures.items()}
            tell(StageProgressed(self.job.name, float(done), float(total), numbers))

    def saved(self, tell: Tell, problem: str | None) -> None:
        """Reports once that checkpoints can no longer be written, while it is still time to make room for them."""
        name, before = self.job.name, self.unsaved
        self.unsaved = f"its checkpoint could not be written: {problem}" if problem else ""
        if self.unsaved and not before:
            risk = "If it stops before one can be written, its work since the last one is lost"
            tell(Noted(f"{name}: {self.unsaved}. {risk}: check the disk that holds {self.store.root} now."))
        elif before and not self.unsaved:
            tell(Noted(f"{name}: its checkpoints can be written again"))

    def stop_requested(self) -> bool:
        moment = time.monotonic()
        if moment - self.looked >= LOOK_EVERY:
            self.looked = moment
            self.stopping = self.job.stop_flag.exists()
        return self.stopping

    def lineage(self) -> tuple[LineageRecord, ...]:
        return read_lineage(self.store, self.job.lineage)


def read_lineage(store: Store, ancestors: Mapping[str, Ancestor]) -> tuple[LineageRecord, ...]:
    """What the store knows about `ancestors`, named as in this workflow; those without a record are left out."""
    records = []
    for name, ancestor in ancestors.items():
        record = store.record(ancestor.key)
        if record is None:
            continue
        provenance: Mapping[str, Any] = record.provenance
        parts: Mapping[str, Any] = record.parts
        computer = {name: fact for name, fact in provenance["machine"].items() if name != "host"}  # its owner's affair
        records.append(
            LineageRecord(
                name=name,
                uses=parts["stage"],
                seconds=record.seconds,
                inputs=ancestor.upstream,  # not those of the record: another workflow may have made it
                facts={**computer, **provenance["facts"], **_accepted_fact(record)},
                versions=provenance["versions"],
                parameters=parts["parameters"],
                private=provenance["private"],
                outputs=tuple(record.outputs.values()),
            )
        )
    return tuple(records)


def from_accepted(store: Store, upstream: Mapping[str, str]) -> list[str]:
    """Names of the stages whose results were accepted, not made, among those of the keys `upstream` and behind them."""
    names: dict[str, None] = {}
    for name, key in upstream.items():
        record = store.record(key)
        if record:
            names |= dict.fromkeys([*record.provenance.get("from_accepted", ()), *([name] if record.accepted else [])])
    return list(names)


def _accepted_fact(record: Record) -> dict[str, Json]:
    notes = [f"{note['when']} although {', '.join(note['changes'])}" for note in record.accepted]
    return {"accepted": "; ".join(notes)} if notes else {}
