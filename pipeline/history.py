"""What the runs of a workflow did: one file a run, a line for each stage as it ended.

    runs/<workflow>/<time>-<id>.jsonl

`status` and `explain` learn from it what a stage made last and why it failed since, without opening a record for each
stage; `gc` learns which results the last runs used. A line that a killed run left unfinished is passed over. Names of
stages may tell of a message, so nobody else can read these files.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pipeline.events import State


@dataclass(frozen=True)
class StageResult:
    """How a stage ended in a run; `cause` says why it failed or was skipped, `outputs` are digests."""

    name: str
    state: State
    key: str | None = None
    outputs: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    private: bool = False
    cause: str | None = None


@dataclass(frozen=True)
class LastResult:
    """The last result of a stage, None where it never had one, and the cause of its failure since, if it failed."""

    made: StageResult | None = None
    failed: str | None = None


class Journal:
    """The file of a run under way."""

    def __init__(self, folder: Path, **facts: object) -> None:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        started = datetime.now(UTC)
        self.path = folder / f"{started:%Y%m%dT%H%M%S.%fZ}-{uuid.uuid4().hex[:8]}.jsonl"
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o600)
        self._file = os.fdopen(descriptor, "a", encoding="utf-8", buffering=1)
        self._write({"started": started.isoformat(timespec="seconds"), "process": os.getpid(), **facts})

    def add(self, result: StageResult) -> None:
        """Keeps how a stage ended; of two lines about one stage the later counts."""
        content: dict[str, object] = {"name": result.name, "state": result.state}
        content |= {"key": result.key} if result.key else {}
        content |= {"outputs": dict(result.outputs), "seconds": round(result.seconds, 3)} if result.outputs else {}
        content |= {"private": True} if result.private else {}
        content |= {"cause": result.cause} if result.cause else {}
        self._write(content)

    def _write(self, content: Mapping[str, object]) -> None:
        self._file.write(json.dumps(content) + "\n")

    def close(self) -> None:
        self._file.close()


class History:
    """The runs of the workflows of one store, in the folder `runs`."""

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def begin(self, workflow: str, **facts: object) -> Journal:
        """The journal of a run that begins now; `facts` are written first."""
        self._runs.mkdir(parents=True, exist_ok=True, mode=0o700)
        return self._journal(self._runs / workflow, **facts)

    def _journal(self, folder: Path, **facts: object) -> Journal:
        return Journal(folder, **facts)

    def workflows(self) -> list[str]:
        """Names of the workflows that ever ran."""
        return sorted(path.name for path in self._runs.iterdir()) if self._runs.is_dir() else []

    def journals(self, workflow: str) -> list[Path]:
        """The files of a workflow's runs, the newest first."""
        return sorted((self._runs / workflow).glob("*.jsonl"), reverse=True)

    def results(self, journal: Path) -> dict[str, StageResult]:
        """How the stages of one run ended, by name."""
        return {content["name"]: _result(content) for content in _lines(journal) if "name" in content}

    def last(self, workflow: str, names: Collection[str]) -> dict[str, LastResult]:
        """The last result of each of the stages `names`, as far back as needed."""
        made: dict[str, StageResult] = {}
        failed: dict[str, str] = {}
        for journal in self.journals(workflow):
            if len(made) == len(names):
                break
            for name, result in self.results(journal).items():
                if name not in names or name in made:
                    continue
                if result.outputs:
                    made[name] = result
                elif result.state == "failed":
                    failed.setdefault(name, result.cause or "failed")
        return {name: LastResult(made.get(name), failed.get(name)) for name in names}


def _lines(journal: Path) -> Iterator[dict[str, Any]]:
    for line in journal.read_bytes().splitlines():
        try:
            content = json.loads(line)
        except ValueError:  # the run was killed while it wrote
            continue
        if isinstance(content, dict):
            yield content


def _result(content: Mapping[str, Any]) -> StageResult:
    return StageResult(
        name=content["name"],
        state=content["state"],
        key=content.get("key"),
        outputs=content.get("outputs", {}),
        seconds=content.get("seconds", 0.0),
        private=content.get("private", False),
        cause=content.get("cause"),
    )
