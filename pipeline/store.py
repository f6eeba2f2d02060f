"""The store: every result once, under the hash of what it is, and every action under the hash of what it depends on.

    .gitignore                       has git pass over all of this
    actions/<key>/record.json        what an action was made of, what came out, and how it went
    objects/<digest>/                artifacts, immutable
    latest/<workflow>/<stage>.<output>   links to the objects of the last run, for their owner: names tell of messages
    code/<digest>.json               the digests of the modules behind a stage and of what they define, for `explain`
    runs/<workflow>/<time>-<id>.jsonl    how the stages of a run ended: see `history`
    pins/<name>.json                 results that `gc` keeps: see `pins`
    logs/<workflow>/<stage>.log      what a stage said when it last ran; `logs/<workflow>/private` if it is private
    scratch/<key>/                   checkpoints of an action that was interrupted
    locks/<key>.lock                 held by the kernel for the process that works on an action
    locks/runs/<workflow>            held together by the runs of a workflow: see `other_runs`
    external/<digest>.json           names and digests of the files behind a digest, for `explain`
    cache/                           what can be computed again: of stages, their sources and external files
    damaged/                         what is not what was written, until the next `gc`: see `damaged`
    temporary/<id>/                  what a process is writing; everything else appears by renaming, whole

Two processes may use one store: a lock lets one of them do an action, and whoever comes second finds it done. All who
run hold `locks/in_use` together; `gc` holds it alone.
"""

from __future__ import annotations

import os
import shutil
import threading
import uuid
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from pipeline.artifact import Artifact, ArtifactWriter, flush, load, publish
from pipeline.canonical import Json
from pipeline.damaged import ACTIONS, FOREIGN, OBJECTS, Damaged
from pipeline.disk import FULL, entries_of, leads_elsewhere, make_folder, remove, remove_where_it_lies, size_of
from pipeline.errors import CorruptArtifact, UserError
from pipeline.external import from_home
from pipeline.hidden import hide_from_git
from pipeline.history import History
from pipeline.in_use import held, is_held
from pipeline.latest import Latest
from pipeline.manifest import MANIFEST
from pipeline.pins import Pins
from pipeline.record import RECORD, Record, read_record
from pipeline.sealed import read_sealed, sealed, write_text_whole
from pipeline.temporary import OwnFolder, sweep

LOCKS, IN_USE = "locks", "in_use"


@dataclass(frozen=True)
class Young:
    """Keys of actions and digests of artifacts."""

    actions: frozenset[str] = frozenset()
    objects: frozenset[str] = frozenset()


class Store:
    """A store in the directory `root`, which is made by what is first written to it, where it is missing."""

    def __init__(self, root: Path) -> None:
        self.root = from_home(root).absolute()  # a shell leaves the ~ of --store=~/results
        self._own: OwnFolder | None = None
        self._making = threading.Lock()
        self._latest = Latest(self.root, self.temporary)

    def __repr__(self) -> str:
        return f"Store({str(self.root)!r})"

    @property
    def address(self) -> str:
        """By which another process opens this store."""
        return str(self.root)

    def mark(self) -> None:
        """Makes the folder one that `is_store` knows, and that git passes over."""
        (self.folder(LOCKS) / IN_USE).touch()
        hide_from_git(self.root)

    def object(self, digest: str) -> Path:
        """Where the artifact of that digest is, or would be."""
        return self.root / "objects" / digest

    def artifact(self, digest: str) -> Artifact:
        """Raises CorruptArtifact where it is missing or damaged, or another one lies in its place."""
        path = self.object(digest)
        if path.is_symlink():
            raise CorruptArtifact(f"{path}: a link; expected a folder")
        artifact = load(path)
        if artifact.digest != digest:
            raise CorruptArtifact(f"{path}: holds the artifact {artifact.digest}")
        return artifact

    def log(self, workflow: str, name: str, private: bool = False) -> Path:
        folder = self.root / "logs" / workflow
        return (folder / "private" if private else folder) / f"{name}.log"

    def keep_log(self, path: Path) -> None:
        """Keeps a log that is finished where others find it too."""

    @property
    def history(self) -> History:
        return History(self.root / "runs")

    @property
    def pins(self) -> Pins:
        return Pins(self.root / "pins")

    @property
    def actions(self) -> frozenset[str]:
        """Keys of all actions that have a record, whole or not; one look at the folder."""
        return self._names("actions")

    @property
    def objects(self) -> frozenset[str]:
        """Digests of all artifacts, whole or not; one look at the folder."""
        return self._names("objects")

    @property
    def young(self) -> Young:
        """What a run that no lock tells of may be about to use, though nothing names it yet; nothing in a folder."""
        return Young()

    @property
    def damaged(self) -> Damaged:
        return Damaged(self.root / "damaged")

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is strange about the store, as far as it was looked at."""
        return ()

    def holds(self, digest: str) -> bool:
        """Whether there is an artifact of that digest, whole or not."""
        return os.path.lexists(self.object(digest))

    def place(self, digest: str) -> str:
        """Where an artifact is, or would be, in words."""
        return str(self.object(digest))

    def look(self, workflow: str, stages: Collection[str]) -> None:
        """Before a run asks for one action after the other: a store that is far away learns at once what is there."""

    def _names(self, folder: str) -> frozenset[str]:
        path = self.root / folder
        return frozenset(entry.name for entry in os.scandir(path)) if path.is_dir() else frozenset()

    def folder(self, *names: str) -> Path:
        """A folder of the store, made where it is missing; it survives a power cut."""
        return make_folder(self.root, *names)

    def temporary(self) -> Path:
        """A new path to write to, on the file system of the store, that nobody else can reach.

        What is there is removed when this store, or the process, comes to its end: by the next run if need be.
        """
        with self._making:  # of two threads one would lose its folder to the other
            if self._own is None or not self._own.path.is_dir():
                self._own = OwnFolder(self.folder("temporary"))
            return self._own.path / uuid.uuid4().hex

    def sweep(self) -> None:
        """Removes what processes left behind that were killed: what they wrote, and checkpoints of finished actions."""
        sweep(self.root / "temporary")
        for key in [entry.name for entry in entries_of(self.root, "scratch")]:
            with suppress(OSError, Timeout), self.lock(key).acquire(blocking=False):
                if self.find(key):
                    shutil.rmtree(self.root / "scratch" / key)

    def lock(self, key: str) -> FileLock:
        """The lock of an action; the kernel frees it when the process ends, however it ends."""
        return FileLock(self.folder(LOCKS) / f"{key}.lock")

    def is_locked(self, key: str) -> bool:
        """Whether a process works on an action just now, as far as can be seen from here."""
        return is_held(self.root / LOCKS / f"{key}.lock")

    @contextmanager
    def in_use(self, alone: bool = False) -> Iterator[None]:
        """Held by every process that works with results; `alone` by one that deletes some.

        Raises CommandError where that cannot be had at once: another process deletes, or others work.
        """
        with held(self.folder(LOCKS) / IN_USE, self.root, alone):
            hide_from_git(self.root)
            yield

    def find(self, key: str) -> Record | None:
        """The record of an action whose every output is there with all its files, each of its size; None otherwise."""
        record = self.record(key)
        return record if record and all(self.is_whole(digest) for digest in record.outputs.values()) else None

    def send_late(self, key: str) -> Record | None:
        """The record of an action that was done here but did not get where the store is, put there now; else None."""
        return None

    def is_whole(self, digest: str) -> bool:
        """Whether an artifact has a sound manifest and all its files, each of its size. Their bytes are not read."""
        try:
            self.artifact(digest).check_sizes()
        except CorruptArtifact:
            return False
        return True

    def check_object(self, digest: str) -> int:
        """Reads every byte of an artifact where it is kept, and returns their number.

        Raises CorruptArtifact where it is missing or not what was written. What is not its own does not count.
        """
        artifact = self.artifact(digest)
        artifact.verify()
        return sum(file.size for file in artifact.manifest.files.values())

    def is_sound(self, digest: str) -> bool:
        """Whether an artifact is what was written, every byte of it."""
        try:
            self.artifact(digest).verify()
        except CorruptArtifact:
            return False
        return True

    def foreign(self, digest: str) -> tuple[str, ...]:
        """Names of what lies in an artifact and is no part of it; none where that cannot be seen."""
        try:
            return self.artifact(digest).foreign()
        except (CorruptArtifact, OSError):
            return ()

    def set_foreign_aside(self, digest: str, name: str) -> None:
        """Moves something of `foreign` out of an artifact, which stays."""
        self.damaged.take(self.object(digest) / name, FOREIGN, digest, *name.split("/"))

    def set_aside(self, digest: str) -> None:
        """Moves a damaged artifact to `damaged`, so that a whole one can take its place; a sound one stays."""
        with self.lock(digest):  # else a whole one that another process has just put there could be taken
            self._clear_damaged(digest)

    def remains(self, key: str) -> tuple[str, ...]:
        """Where something is left of an action that was done once, whose result `find` does not find whole."""
        places = (self.root / "actions" / key, *self.damaged.records(key))
        return tuple(str(place) for place in places if os.path.lexists(place))

    def record(self, key: str) -> Record | None:
        """The record of an action, whether or not its outputs are still there."""
        return read_record(self.root / "actions" / key / RECORD, key)

    def kept_record(self, key: str) -> Record | None:
        """The record of an action, read where it is kept; None where it is missing or not what was written."""
        return self.record(key)

    def records(self) -> Iterator[Record]:
        """All records that can be read, by key."""
        for key in sorted(self.actions):
            record = self.record(key)
            if record:
                yield record

    def set_record_aside(self, key: str) -> None:
        """Moves a damaged record to `damaged`, so that its action is done again."""
        self.damaged.take(self.root / "actions" / key, ACTIONS, key)

    def delete_record(self, key: str) -> None:
        """Deletes a record, at once or (but on a full disk) not at all; what it told of stays until `delete_object`."""
        self._delete(self.root / "actions" / key, RECORD)

    def delete_object(self, digest: str) -> None:
        """Deletes an artifact, at once or (but on a full disk) not at all. Its records must be deleted before."""
        self._delete(self.object(digest), MANIFEST)

    def _delete(self, path: Path, first: str) -> None:
        try:
            aside = self.temporary()
            with suppress(FileNotFoundError):
                path.rename(aside)
        except OSError as error:
            if error.errno not in FULL:
                raise
            remove_where_it_lies(path, first)  # to make room must be possible where there is none
        else:
            remove(aside)

    def sizes_of_records(self, keys: Collection[str]) -> dict[str, int]:
        """Bytes of records, by key."""
        return {key: size_of(self.root / "actions" / key) for key in keys}

    def sizes_of_objects(self, digests: Collection[str]) -> dict[str, int]:
        """Bytes of all files of artifacts, damaged or not, by digest."""
        return {digest: size_of(self.object(digest)) for digest in digests}

    def entries(self, folder: str) -> dict[str, int]:
        """What is in a folder of the store, such as `logs`: names from the store's root on, and the bytes of each.

        Links are passed over: they may lead anywhere.
        """
        names = [f"{folder}/{entry.name}" for entry in entries_of(self.root, *folder.split("/"))]
        return {name: size_of(self.root / name) for name in names}

    def delete_entry(self, name: str) -> None:
        """Deletes what has a name of `entries`. Raises UserError for a name that leads elsewhere."""
        *folders, last = name.split("/")
        if not folders or last in ("", ".", "..") or leads_elsewhere(self.root, *folders):
            raise UserError("not the name of something in the store", where=self.root, found=name)
        remove(self.root / name)

    def abandoned(self) -> dict[str, int]:
        """Names and bytes of what nobody will go on with and `sweep` does not remove; nothing in a folder."""
        return {}

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
            self.folder("objects")
            with self.lock(artifact.digest):
                self._clear_damaged(artifact.digest)
                publish(artifact, self.object(artifact.digest))
        record = Record(key, parts, outputs, provenance)
        self._write_record(record, record.private or any(writer.private for writer in writers.values()))
        return self.find(key) or record

    def add(self, record: Record) -> None:
        """Gives results that are in the store already one more record."""
        self._write_record(record, record.private)

    def _write_record(self, record: Record, private: bool) -> None:
        aside, target = self.temporary(), self.folder("actions") / record.key
        aside.mkdir(mode=0o700 if private else 0o777)
        content = {
            "key": record.key,
            "parts": dict(record.parts),
            "outputs": dict(record.outputs),
            "provenance": dict(record.provenance),
        }
        file = aside / RECORD
        file.touch(mode=0o600 if private else 0o644)
        file.write_text(sealed(content))
        flush(file)
        flush(aside)
        if os.path.lexists(target) and self.find(record.key) is None:
            self.damaged.take(target, ACTIONS, record.key)
        try:
            aside.rename(target)
        except OSError:
            if not (target / RECORD).is_file():
                raise
            shutil.rmtree(aside)
        flush(target.parent)

    def _clear_damaged(self, digest: str) -> None:
        if os.path.lexists(self.object(digest)) and not self.is_sound(digest):
            self.damaged.take(self.object(digest), OBJECTS, digest)

    def link_latest(self, workflow: str, name: str, outputs: Mapping[str, str]) -> None:
        """Points `latest/<workflow>/<stage>.<output>` to the objects of a result. Raises OSError where it cannot."""
        self._latest.link(workflow, name, outputs)

    def latest(self, workflow: str, name: str, output: str) -> Path:
        return self._latest.path(workflow, name, output)

    def keep_code(self, digest: str, modules: Mapping[str, str], definitions: Mapping[str, Mapping[str, str]]) -> None:
        """Keeps which modules a digest of code stands for, and the digests of what each of them defines.

        Where it cannot, that only costs an explanation.
        """
        content = {name: {"digest": module, "definitions": dict(definitions[name])} for name, module in modules.items()}
        with suppress(OSError):
            self.folder("code")
            write_text_whole(self._code(digest), sealed({"modules": content}), self.temporary())

    def latest_digests(self) -> dict[str, str]:
        """The digest that each link `<workflow>/<stage>.<output>` in `latest` leads to, in the store or no longer."""
        return self._latest.digests()

    def unlink_latest(self, name: str) -> None:
        """Removes a link of `latest_digests`."""
        self._latest.unlink(name)

    def knows_code(self, digest: str) -> bool:
        return self._code(digest).is_file()

    def code(self, digest: str) -> dict[str, Any] | None:
        """For each module that a digest of code stands for its `digest` and `definitions`; None where not known."""
        content = read_sealed(self._code(digest))
        return content["modules"] if content else None

    def _code(self, digest: str) -> Path:
        return self.root / "code" / f"{digest}.json"
