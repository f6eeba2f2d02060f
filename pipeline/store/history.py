"""What the runs of a workflow did: one file per run, with a line for each stage as it ended.

    runs/<workflow>/<time>-<id>.jsonl

From it, `status` and `explain` learn what a stage last made and why it has failed since, without opening a record for
each stage; `gc` learns which results the last runs used and which checkpoints they left. Results do not depend on it: a
line lost to a full disk, a kill or a power cut (nothing is flushed here) costs an explanation. So a journal that cannot
be written ends no run, and lines that cannot be read are skipped. Names of stages may reveal a message, so nobody else
can read these files.
"""

from __future__ import annotations

import errno
import json
import os
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast, get_args

from pipeline.disk import entries_of, leads_elsewhere, parse_json, read_plain_file
from pipeline.events import StageState
from pipeline.store.record import is_digest, is_time


@dataclass(frozen=True)
class StageResult:
    """How a stage ended in a run; `cause` says why it failed or was skipped, `outputs` holds digests."""

    name: str
    state: StageState
    key: str | None = None
    outputs: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    private: bool = False
    cause: str | None = None


@dataclass(frozen=True)
class LastResult:
    """The last result of a stage, None if it never had one, and its failure since then, if any."""

    made: StageResult | None = None
    failed: StageResult | None = None

    def cause(self, key: str | None) -> str | None:
        """Why it failed; None if it did not, or if that was another action than `key`."""
        if self.failed is None or (key is not None and self.failed.key not in (None, key)):
            return None
        return self.failed.cause or "failed"


@dataclass(frozen=True)
class PastRun:
    """One run according to its journal; `began` holds the keys of the actions that it started.

    `whole`: it ran all stages of the workflow and came to its end, with or without failures, and its journal has every
    stage. A run of only some stages is not whole, nor is one that was interrupted or killed.
    """

    results: Mapping[str, StageResult]
    began: frozenset[str]
    whole: bool


STAMP = "%Y%m%dT%H%M%S.%fZ"
"""The time in a journal's name, which puts runs in order."""


def _after_all_in(folder: Path, now: datetime) -> datetime:
    """Now, or just after the newest journal in a folder if that is later, because the clock is or was wrong."""
    names = [entry.name for entry in os.scandir(folder) if entry.name.endswith(".jsonl")]
    with suppress(ValueError, OverflowError):  # no name of ours
        newest = datetime.strptime(max(names, default="").partition("-")[0], STAMP).replace(tzinfo=UTC)
        return max(now, newest + timedelta(microseconds=1))
    return now


class Journal:
    """The journal of a run in progress. Once it is open, failed writes are ignored."""

    def __init__(self, folder: Path, **facts: object) -> None:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        started = datetime.now(UTC)
        self.path = folder / f"{_after_all_in(folder, started):{STAMP}}-{uuid.uuid4().hex[:8]}.jsonl"
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o600)
        self._file = os.fdopen(descriptor, "ab", buffering=0)
        self._unfinished = False
        self._write({"started": started.isoformat(timespec="seconds"), "process": os.getpid(), **facts})

    def add(self, result: StageResult) -> None:
        """Records how a stage ended; of two lines about one stage, the later counts."""
        content: dict[str, object] = {"name": result.name, "state": result.state}
        content |= {"key": result.key} if result.key else {}
        content |= {"outputs": dict(result.outputs), "seconds": round(result.seconds, 3)} if result.outputs else {}
        content |= {"private": True} if result.private else {}
        content |= {"cause": result.cause} if result.cause else {}
        self._write(content)

    def begin(self, key: str) -> None:
        """Records that an action was started: if no end follows, its checkpoint may be worth something."""
        self._write({"began": key})

    def end(self) -> None:
        """Records that the run came to its end."""
        self._write({"ended": datetime.now(UTC).isoformat(timespec="seconds")})

    def _write(self, content: Mapping[str, object]) -> None:
        line = json.dumps(content).encode() + b"\n"
        if self._unfinished:
            line = b"\n" + line
        try:
            self._unfinished = self._file.write(line) != len(line)
        except OSError:
            self._unfinished = True

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class History:
    """The runs of the workflows of one store, in the folder `runs`."""

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def begin(self, workflow: str, **facts: object) -> Journal:
        """The journal of a run that begins now, with `facts` in its first line. Raises OSError if it cannot be made."""
        if leads_elsewhere(self._runs.parent, self._runs.name, workflow):
            raise OSError(errno.ELOOP, "a link; expected a folder", str(self._runs / workflow))
        self._runs.mkdir(parents=True, exist_ok=True, mode=0o700)
        return self._journal(self._runs / workflow, **facts)

    def _journal(self, folder: Path, **facts: object) -> Journal:
        return Journal(folder, **facts)

    def workflows(self) -> list[str]:
        """Names of all workflows that have run."""
        return [entry.name for entry in entries_of(self._runs.parent, self._runs.name)]

    def journals(self, workflow: str) -> list[Path]:
        """The files of a workflow's runs, newest first."""
        found = entries_of(self._runs.parent, self._runs.name, workflow)
        return [Path(entry.path) for entry in reversed(found) if entry.name.endswith(".jsonl")]

    def results(self, journal: Path) -> dict[str, StageResult]:
        """How the stages of one run ended, by name; empty if the journal cannot be read."""
        with suppress(OSError):  # another user's journal
            return _results(_lines(journal))
        return {}

    def read(self, journal: Path) -> PastRun:
        """Everything in a journal. Raises OSError if it cannot be read."""
        lines = list(_lines(journal))
        results = _results(lines)
        began = any(content.get("whole") is True and content.get("stages") == len(results) for content in lines)
        ended = any("ended" in content for content in lines)
        keys = frozenset(content["began"] for content in lines if is_digest(content.get("began")))
        return PastRun(results, keys, whole=began and ended)

    def last_given(self, workflow: str) -> tuple[str, ...]:
        """The options that set values in the last run of a workflow, as they were typed; empty if it has not run."""
        for journal in self.journals(workflow):
            with suppress(OSError):
                for content in _lines(journal):
                    if isinstance(given := content.get("given"), list):
                        return tuple(map(str, given))
        return ()

    def outputs(self) -> Iterator[tuple[str, str]]:
        """`<workflow>/<stage>.<output>` and digest of every result, those of a workflow's newest run first."""
        for workflow in self.workflows():
            for journal in self.journals(workflow):
                for name, result in self.results(journal).items():
                    yield from ((f"{workflow}/{name}.{output}", digest) for output, digest in result.outputs.items())

    def latest_digests(self) -> dict[str, str]:
        """The digest of the last result of every output `<workflow>/<stage>.<output>`, according to the journals.

        Outputs of stages that have failed since then are left out.
        """
        found: dict[str, str] = {}
        for workflow in self.workflows():
            told: set[str] = set()
            for journal in self.journals(workflow):
                for name, result in self.results(journal).items():
                    if name not in told:
                        found |= {f"{workflow}/{name}.{output}": digest for output, digest in result.outputs.items()}
                    if result.outputs or result.state == "failed":
                        told.add(name)
        return found

    def made(self, workflow: str) -> dict[str, list[str]]:
        """The keys under which each stage of a workflow made something, newest first, according to the journals."""
        found: dict[str, dict[str, None]] = {}
        for journal in self.journals(workflow):
            for name, result in self.results(journal).items():
                if result.outputs and result.key:
                    found.setdefault(name, {}).setdefault(result.key)
        return {name: list(keys) for name, keys in found.items()}

    def last(self, workflow: str, names: Collection[str]) -> dict[str, LastResult]:
        """The last result of each of the stages `names`, looking back as far as needed."""
        made: dict[str, StageResult] = {}
        failed: dict[str, StageResult] = {}
        for journal in self.journals(workflow):
            if len(made) == len(names):
                break
            for name, result in self.results(journal).items():
                if name not in names or name in made:
                    continue
                if result.outputs:
                    made[name] = result
                elif result.state == "failed":
                    failed.setdefault(name, result)
        return {name: LastResult(made.get(name), failed.get(name)) for name in names}


def _lines(journal: Path) -> Iterator[dict[str, Any]]:
    for line in read_plain_file(journal).splitlines():
        try:
            content = parse_json(line)
        except ValueError:  # the run was killed while it wrote
            continue
        if isinstance(content, dict):
            yield content


def _results(lines: Iterable[Mapping[str, Any]]) -> dict[str, StageResult]:
    results = (_result(content) for content in lines)
    return {result.name: result for result in results if result}


def _result(content: Mapping[str, Any]) -> StageResult | None:
    """The result in a line; None if the line is not in our format."""
    name, state, key, outputs = (content.get(word) for word in ("name", "state", "key", "outputs"))
    seconds, cause = content.get("seconds", 0.0), content.get("cause")
    outputs = {} if outputs is None else outputs
    sound = (
        isinstance(name, str)
        and state in get_args(StageState)
        and (key is None or is_digest(key))
        and is_time(seconds)
        and isinstance(cause, str | None)
        and isinstance(outputs, dict)
        and all(isinstance(value, str) for value in outputs.values())
    )
    if not sound:
        return None
    private = content.get("private") is True
    return StageResult(
        str(name), cast(StageState, state), key, cast(dict[str, str], outputs), float(seconds), private, cause
    )
