"""The store: every result once, under the hash of what it is, and every action under the hash of what it depends on.

    actions/<key>/record.json        what an action was made of, what came out, and how it went
    objects/<digest>/                artifacts, immutable
    latest/<workflow>/<stage>.<output>   links to the objects of the last run, for people
    code/<digest>.json               the digests of the modules behind a stage, for `explain`
    runs/<workflow>/<time>-<id>.jsonl    how the stages of a run ended: see `history`
    logs/<workflow>/<stage>.log      what a stage said when it last ran; `logs/<workflow>/private` if it is private
    scratch/<key>/                   checkpoints of an action that was interrupted
    locks/<key>.lock                 held by the kernel for the process that works on an action
    cache/                           what can be computed again: declarations of stages
    temporary/                       what is being written; everything else appears by renaming, whole

Two processes may use one store: a lock lets one of them do an action, and whoever comes second finds it done. All who
run hold `locks/in_use` together; `gc` holds it alone.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import uuid
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock

from pipeline.artifact import Artifact, ArtifactWriter, flush, load, publish
from pipeline.canonical import Json
from pipeline.errors import CommandError, CorruptArtifact
from pipeline.history import History

RECORD = "record.json"
KEY = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Record:
    """An action that was done.

    `parts` is what its key is the hash of; `outputs` the digests of what came out; `provenance` all else worth
    knowing: when, how long, with which versions, where, from which commit.
    """

    key: str
    parts: Mapping[str, Json]
    outputs: Mapping[str, str]
    provenance: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        return float(self.provenance["seconds"])

    @property
    def private(self) -> bool:
        """Whether any output is private."""
        return bool(self.provenance.get("private"))


class Store:
    """A store in the directory `root`, which is made where it is missing."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self.root.mkdir(parents=True, exist_ok=True)

    def __repr__(self) -> str:
        return f"Store({str(self.root)!r})"

    @property
    def address(self) -> str:
        """By which another process opens this store."""
        return str(self.root)

    def object(self, digest: str) -> Path:
        """Where the artifact of that digest is, or would be."""
        return self.root / "objects" / digest

    def artifact(self, digest: str) -> Artifact:
        """Raises CorruptArtifact where it is missing or damaged."""
        return load(self.object(digest))

    def log(self, workflow: str, name: str, private: bool = False) -> Path:
        folder = self.root / "logs" / workflow
        return (folder / "private" if private else folder) / f"{name}.log"

    def keep_log(self, path: Path) -> None:
        """Keeps a log that is finished where others find it too."""

    @property
    def history(self) -> History:
        return History(self.root / "runs")

    @property
    def actions(self) -> frozenset[str]:
        """Keys of all actions that have a record, whole or not; one look at the folder."""
        return self._names("actions")

    @property
    def objects(self) -> frozenset[str]:
        """Digests of all artifacts, whole or not; one look at the folder."""
        return self._names("objects")

    def look(self, workflow: str, stages: Collection[str]) -> None:
        """Before a run asks for one action after the other: a store that is far away learns at once what is there."""

    def _names(self, folder: str) -> frozenset[str]:
        path = self.root / folder
        return frozenset(entry.name for entry in os.scandir(path)) if path.is_dir() else frozenset()

    def folder(self, *names: str) -> Path:
        """A folder of the store, made where it is missing."""
        path = self.root.joinpath(*names)
        path.mkdir(parents=True, exist_ok=True)
        return path

    def temporary(self) -> Path:
        """A new path to write to, on the file system of the store."""
        return self.folder("temporary") / uuid.uuid4().hex

    def lock(self, key: str) -> FileLock:
        """The lock of an action; the kernel frees it when the process ends, however it ends."""
        return FileLock(self.folder("locks") / f"{key}.lock")

    @contextmanager
    def in_use(self, alone: bool = False) -> Iterator[None]:
        """Held by every process that works with results; `alone` by one that deletes some.

        Raises CommandError where that cannot be had at once: another process deletes, or others work.
        """
        path = self.folder("locks") / "in_use"
        with path.open("a") as file:
            try:
                fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
            except BlockingIOError:
                others = "runs are using the store" if alone else "results are being deleted from the store"
                raise CommandError(others, where=self.root, remedy="Try again when that has ended.") from None
            yield

    def find(self, key: str) -> Record | None:
        """The record of an action whose every output is there with all its files, each of its size; None otherwise."""
        record = self.record(key)
        return record if record and all(self.is_whole(digest) for digest in record.outputs.values()) else None

    def is_whole(self, digest: str) -> bool:
        """Whether an artifact has a sound manifest and all its files, each of its size. Their bytes are not read."""
        try:
            self.artifact(digest).check_sizes()
        except CorruptArtifact:
            return False
        return True

    def is_sound(self, digest: str) -> bool:
        """Whether an artifact is what was written, every byte of it."""
        try:
            self.artifact(digest).verify()
        except CorruptArtifact:
            return False
        return True

    def set_aside(self, digest: str) -> None:
        """Takes a damaged artifact out of the store, so that a whole one can take its place."""
        with suppress(FileNotFoundError):  # another process was first
            self.object(digest).rename(self.temporary())

    def record(self, key: str) -> Record | None:
        """The record of an action, whether or not its outputs are still there."""
        content = _read_json(self.root / "actions" / key / RECORD)
        if not content or not {"key", "parts", "outputs", "provenance"} <= content.keys():
            return None
        return Record(content["key"], content["parts"], content["outputs"], content["provenance"])

    def commit(
        self, key: str, parts: Mapping[str, Json], writers: Mapping[str, ArtifactWriter], provenance: Mapping[str, Any]
    ) -> Record:
        """Makes the outputs of an action part of the store, then its record: from then on the action is done.

        If another process was first, its record is returned and the outputs of this one are dropped.
        """
        outputs = {}
        for name, writer in writers.items():
            artifact = writer.seal()
            outputs[name] = artifact.digest
            self._clear_damaged(artifact.digest)
            self.folder("objects")
            publish(artifact, self.object(artifact.digest))
        record = Record(key, parts, outputs, provenance)
        private = any(writer.private for writer in writers.values())
        self._write_record(record, private)
        return self.find(key) or record

    def _write_record(self, record: Record, private: bool) -> None:
        aside, target = self.temporary(), self.folder("actions") / record.key
        aside.mkdir(mode=0o700 if private else 0o777)
        content = {"key": record.key, "parts": record.parts, "outputs": record.outputs, "provenance": record.provenance}
        file = aside / RECORD
        file.write_text(json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n")
        file.chmod(0o600 if private else 0o644)
        flush(file)
        flush(aside)
        if target.exists() and self.find(record.key) is None:
            target.rename(self.temporary())
        try:
            aside.rename(target)
        except OSError:
            if not (target / RECORD).is_file():
                raise
            shutil.rmtree(aside)
        flush(target.parent)

    def _clear_damaged(self, digest: str) -> None:
        """Moves an object aside that is there but cannot be read, so that a whole one can take its place."""
        if self.object(digest).exists() and not self.is_sound(digest):
            self.set_aside(digest)

    def link_latest(self, workflow: str, name: str, outputs: Mapping[str, str]) -> None:
        """Points `latest/<workflow>/<stage>.<output>` to the objects of a result."""
        folder = self.folder("latest", workflow)
        for output, digest in outputs.items():
            link = folder / f"{name}.{output}"
            target = os.path.relpath(self.object(digest), folder)
            if link.is_symlink() and os.readlink(link) == target:  # noqa: PTH115 — Path.readlink would normalise it
                continue
            aside = self.temporary()
            aside.symlink_to(target)
            aside.replace(link)

    def latest(self, workflow: str, name: str, output: str) -> Path:
        return self.root / "latest" / workflow / f"{name}.{output}"

    def keep_code(self, digest: str, modules: Mapping[str, str]) -> None:
        """Keeps which modules a digest of code stands for."""
        path = self._code(digest)
        if not path.is_file():
            self.folder("code")
            write_text_whole(path, json.dumps(dict(modules), indent=1, sort_keys=True) + "\n", self.temporary())

    def code(self, digest: str) -> dict[str, str] | None:
        """The modules that a digest of code stands for, each with its own digest; None where that is not known."""
        return _read_json(self._code(digest))

    def _code(self, digest: str) -> Path:
        return self.root / "code" / f"{digest}.json"


def write_text_whole(path: Path, text: str, aside: Path) -> None:
    """Writes a file so that readers see the old or the new one, never a part."""
    aside.write_text(text)
    aside.replace(path)


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
