"""The store: each result once, under the hash of its content, and each action under the hash of what it depends on.

    .gitignore                       makes git ignore all of this
    actions/<key>/record.json        what went into an action, what came out, and how it went
    objects/<digest>/                artifacts, immutable
    latest/<workflow>/<stage>.<output>   links to the objects of the last run; private, since names may reveal messages
    code/<digest>.json               the digests of the modules behind a stage and of what they define, for `explain`
    runs/<workflow>/<time>-<id>.jsonl    how the stages of a run ended: see `history`
    pins/<name>.json                 results that `gc` keeps: see `pins`
    logs/<workflow>/<stage>.log      what a stage logged when it last ran; in `logs/<workflow>/private` if private
    scratch/<key>/                   checkpoints of an action that was interrupted
    locks/<key>.lock                 the lock of an action, held by the process that works on it
    locks/runs/<workflow>            shared by the runs of a workflow: see `other_runs`
    external/<digest>.json           names and digests of the files behind a digest, for `explain`
    cache/                           what can be recomputed about stages, their sources and external files
    damaged/                         damaged data, until the next `gc`: see `damaged`
    temporary/<id>/                  what a process is writing: records and artifacts appear whole, by renaming

Several processes may use one store: the lock of an action lets one of them do it, and the others then find it done. All
runs share `locks/in_use`; `gc` holds it alone.
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
from pipeline.disk import FULL, entries_of, leads_elsewhere, make_folder, remove, remove_where_it_lies, size_of
from pipeline.errors import CorruptArtifact, UserError
from pipeline.manifest import MANIFEST
from pipeline.store.checksummed import read_checksummed, with_checksum, write_text_whole
from pipeline.store.damaged import ACTIONS, FOREIGN, OBJECTS, Damaged
from pipeline.store.external import from_home
from pipeline.store.git_ignored import make_git_ignore
from pipeline.store.history import History
from pipeline.store.in_use import held, is_held
from pipeline.store.latest import Latest
from pipeline.store.pins import Pins
from pipeline.store.record import RECORD, Record, read_record
from pipeline.store.temporary import OwnFolder, sweep

LOCKS, IN_USE = "locks", "in_use"


@dataclass(frozen=True)
class Young:
    """Keys of actions and digests of artifacts that `gc` must spare: see `Store.young`."""

    actions: frozenset[str] = frozenset()
    objects: frozenset[str] = frozenset()


class Store:
    """A store in the directory `root`, which is created by the first write if it is missing."""

    def __init__(self, root: Path) -> None:
        self.root = from_home(root).absolute()  # a shell does not expand the ~ in --store=~/results
        self._own: OwnFolder | None = None
        self._making = threading.Lock()
        self._latest = Latest(self.root, self.temporary)

    def __repr__(self) -> str:
        return f"Store({str(self.root)!r})"

    @property
    def address(self) -> str:
        """The address at which another process can open this store."""
        return str(self.root)

    def mark(self) -> None:
        """Makes `root` a folder that `is_store` recognises and git ignores. Raises OSError if it cannot."""
        (self.folder(LOCKS) / IN_USE).touch()
        make_git_ignore(self.root)

    def object(self, digest: str) -> Path:
        """The path at which an artifact is, or would be."""
        return self.root / "objects" / digest

    def artifact(self, digest: str) -> Artifact:
        """An artifact, of which only the manifest is read.

        Raises CorruptArtifact if it is missing, its manifest is damaged, or another artifact is in its place.
        """
        path = self.object(digest)
        if path.is_symlink():
            raise CorruptArtifact(f"{path}: a link; expected a folder")
        artifact = load(path)
        if artifact.digest != digest:
            raise CorruptArtifact(f"{path}: holds the artifact {artifact.digest}")
        return artifact

    def log(self, workflow: str, name: str, private: bool = False) -> Path:
        """The path at which a stage's log is, or would be; private ones are in a folder of their own."""
        folder = self.root / "logs" / workflow
        return (folder / "private" if private else folder) / f"{name}.log"

    def keep_log(self, path: Path) -> None:
        """Puts a finished log where other machines find it, too. Does nothing for a folder, where it already is."""

    @property
    def history(self) -> History:
        """What the runs of each workflow did."""
        return History(self.root / "runs")

    @property
    def pins(self) -> Pins:
        """The results that `gc` keeps whatever runs follow."""
        return Pins(self.root / "pins")

    @property
    def actions(self) -> frozenset[str]:
        """Keys of all actions that have a record, whole or not; lists the folder anew each time."""
        return self._names("actions")

    @property
    def objects(self) -> frozenset[str]:
        """Digests of all artifacts, whole or not; lists the folder anew each time."""
        return self._names("objects")

    @property
    def young(self) -> Young:
        """What a run that no lock reveals may be about to use, although nothing refers to it yet; none in a folder."""
        return Young()

    @property
    def damaged(self) -> Damaged:
        """The damaged data that was set aside."""
        return Damaged(self.root / "damaged")

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is odd about the store, as far as it has been read; empty for a folder."""
        return ()

    def holds(self, digest: str) -> bool:
        """Whether there is an artifact of that digest, whole or not."""
        return os.path.lexists(self.object(digest))

    def place(self, digest: str) -> str:
        """Where an artifact is, or would be, for messages."""
        return str(self.object(digest))

    def look(self, workflow: str, stages: Collection[str]) -> None:
        """Prepares for many calls of `find`: a remote store then learns in few requests what is there."""

    def _names(self, folder: str) -> frozenset[str]:
        path = self.root / folder
        return frozenset(entry.name for entry in os.scandir(path)) if path.is_dir() else frozenset()

    def folder(self, *names: str) -> Path:
        """A folder of the store, created durably if it is missing."""
        return make_folder(self.root, *names)

    def temporary(self) -> Path:
        """A new path to write to, on the file system of the store, that nobody else can reach.

        What is there is removed when this object or the process ends, or else by the next run.
        """
        with self._making:  # a second folder, made by another thread, would replace and so remove the first
            if self._own is None or not self._own.path.is_dir():
                self._own = OwnFolder(self.folder("temporary"))
            return self._own.path / uuid.uuid4().hex

    def sweep(self) -> None:
        """Removes what killed processes left behind: what they were writing, and checkpoints of finished actions."""
        sweep(self.root / "temporary")
        for key in [entry.name for entry in entries_of(self.root, "scratch")]:
            with suppress(OSError, Timeout), self.lock(key).acquire(blocking=False):
                if self.find(key):
                    shutil.rmtree(self.root / "scratch" / key)

    def lock(self, key: str) -> FileLock:
        """The lock of an action; the kernel frees it when the process ends, however it ends."""
        return FileLock(self.folder(LOCKS) / f"{key}.lock")

    def is_locked(self, key: str) -> bool:
        """Whether a process is working on an action right now, as far as can be seen from here."""
        return is_held(self.root / LOCKS / f"{key}.lock")

    @contextmanager
    def in_use(self, alone: bool = False) -> Iterator[None]:
        """Holds the store's lock within the block: shared, to work with results, or `alone`, to delete some.

        Raises CommandError if it cannot be had at once, because another process deletes results or uses them, or if
        files cannot be locked there.
        """
        with held(self.folder(LOCKS) / IN_USE, self.root, alone):
            make_git_ignore(self.root)
            yield

    def find(self, key: str) -> Record | None:
        """The record of an action if all its outputs are there, with all files in the right sizes; None otherwise."""
        record = self.record(key)
        return record if record and all(self.is_whole(digest) for digest in record.outputs.values()) else None

    def send_late(self, key: str) -> Record | None:
        """Puts a result into the store that was made here but did not get there, and returns its record; else None."""
        return None

    def put_back(self) -> tuple[str, ...]:
        """Replaces what was set aside by sound copies elsewhere, and returns the keys; here there are none."""
        return ()

    def is_whole(self, digest: str) -> bool:
        """Whether an artifact has a sound manifest and all files, in the right sizes. Their bytes are not read."""
        try:
            self.artifact(digest).check_sizes()
        except CorruptArtifact:
            return False
        return True

    def check_object(self, digest: str) -> int:
        """Reads every byte of an artifact where it is stored, and returns their number.

        Raises CorruptArtifact if it is missing or altered. Foreign files do not count.
        """
        artifact = self.artifact(digest)
        artifact.verify()
        return sum(file.size for file in artifact.manifest.files.values())

    def is_sound(self, digest: str) -> bool:
        """Whether an artifact is there and unaltered; reads every byte of it."""
        try:
            self.artifact(digest).verify()
        except CorruptArtifact:
            return False
        return True

    def foreign(self, digest: str) -> tuple[str, ...]:
        """Names of files in an artifact that are no part of it; empty if that cannot be determined."""
        try:
            return self.artifact(digest).foreign()
        except (CorruptArtifact, OSError):
            return ()

    def set_foreign_aside(self, digest: str, name: str) -> None:
        """Moves one of the files that `foreign` names to `damaged`; the artifact stays."""
        self.damaged.take(self.object(digest) / name, FOREIGN, digest, *name.split("/"))

    def set_aside(self, digest: str) -> None:
        """Moves a damaged artifact to `damaged`, so that a whole one can take its place; a sound one stays."""
        with self.lock(digest):  # otherwise a whole one that another process has just put there could be moved
            self._clear_damaged(digest)

    def remains(self, key: str) -> tuple[str, ...]:
        """Where records are left of an action that was done once, for when `find` does not find its result whole."""
        places = (self.root / "actions" / key, *self.damaged.records(key))
        return tuple(str(place) for place in places if os.path.lexists(place))

    def record(self, key: str) -> Record | None:
        """The record of an action, whether or not its outputs are still there; None if it is missing or altered."""
        return read_record(self.root / "actions" / key / RECORD, key)

    def kept_record(self, key: str) -> Record | None:
        """The record of an action as it is stored, not a copy; None if it is missing or altered."""
        return self.record(key)

    def records(self) -> Iterator[Record]:
        """All readable records, in the order of their keys."""
        for key in sorted(self.actions):
            record = self.record(key)
            if record:
                yield record

    def set_record_aside(self, key: str) -> None:
        """Moves a damaged record to `damaged`, so that its action is done again."""
        self.damaged.take(self.root / "actions" / key, ACTIONS, key)

    def delete_record(self, key: str) -> None:
        """Deletes a record, atomically unless the disk is full; its artifacts stay until `delete_object`."""
        self._delete(self.root / "actions" / key, RECORD)

    def delete_object(self, digest: str) -> None:
        """Deletes an artifact, atomically unless the disk is full. The records that name it must be deleted first."""
        self._delete(self.object(digest), MANIFEST)

    def _delete(self, path: Path, first: str) -> None:
        try:
            aside = self.temporary()
            with suppress(FileNotFoundError):
                path.rename(aside)
        except OSError as error:
            if error.errno not in FULL:
                raise
            remove_where_it_lies(path, first)  # making room must be possible when there is none
        else:
            remove(aside)

    def sizes_of_records(self, keys: Collection[str]) -> dict[str, int]:
        """The size of each record in bytes, by key; 0 if it is missing."""
        return {key: size_of(self.root / "actions" / key) for key in keys}

    def sizes_of_objects(self, digests: Collection[str]) -> dict[str, int]:
        """The size of all files of each artifact in bytes, damaged or not, by digest; 0 if it is missing."""
        return {digest: size_of(self.object(digest)) for digest in digests}

    def entries(self, folder: str) -> dict[str, int]:
        """The entries of a folder of the store, such as `logs`: names relative to the store's root, with their bytes.

        Links are skipped: they may lead anywhere.
        """
        names = [f"{folder}/{entry.name}" for entry in entries_of(self.root, *folder.split("/"))]
        return {name: size_of(self.root / name) for name in names}

    def delete_entry(self, name: str) -> None:
        """Deletes an entry by its name in `entries`. Raises UserError for a name that leads elsewhere."""
        *folders, last = name.split("/")
        if not folders or last in ("", ".", "..") or leads_elsewhere(self.root, *folders):
            raise UserError("not the name of something in the store", where=self.root, found=name)
        remove(self.root / name)

    def abandoned(self) -> dict[str, int]:
        """Names and bytes of what nobody will resume and `sweep` does not remove; empty for a folder."""
        return {}

    def commit(
        self, key: str, parts: Mapping[str, Json], writers: Mapping[str, ArtifactWriter], provenance: Mapping[str, Any]
    ) -> Record:
        """Adds the outputs of an action to the store, then its record, all durably: then the action is done.

        If another process was first, its record is returned, and the outputs of this one are dropped.
        """
        outputs = {}
        for name, writer in writers.items():
            artifact = writer.finish()
            outputs[name] = artifact.digest
            self.folder("objects")
            with self.lock(artifact.digest):
                self._clear_damaged(artifact.digest)
                publish(artifact, self.object(artifact.digest))
        record = Record(key, parts, outputs, provenance)
        self._write_record(record, record.private or any(writer.private for writer in writers.values()))
        return self.find(key) or record

    def add(self, record: Record) -> None:
        """Adds, durably, one more record of results that are already in the store."""
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
        file.write_text(with_checksum(content))
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
        """Points `latest/<workflow>/<stage>.<output>` to the objects of a result. Raises OSError if it cannot."""
        self._latest.link(workflow, name, outputs)

    def latest(self, workflow: str, name: str, output: str) -> Path:
        """The path at which the link to a stage's output is, or would be."""
        return self._latest.path(workflow, name, output)

    def keep_code(self, digest: str, modules: Mapping[str, str], definitions: Mapping[str, Mapping[str, str]]) -> None:
        """Records which modules a digest of code stands for, and the digests of what each of them defines.

        Errors in writing are ignored: they only cost an explanation.
        """
        content = {name: {"digest": module, "definitions": dict(definitions[name])} for name, module in modules.items()}
        with suppress(OSError):
            self.folder("code")
            write_text_whole(self._code(digest), with_checksum({"modules": content}), self.temporary())

    def latest_digests(self) -> dict[str, str]:
        """The digest that each link `<workflow>/<stage>.<output>` leads to, whether or not it is still in the store."""
        return self._latest.digests()

    def unlink_latest(self, name: str) -> None:
        """Removes a link by its name in `latest_digests`; does nothing if there is none."""
        self._latest.unlink(name)

    def knows_code(self, digest: str) -> bool:
        """Whether a digest of code is recorded here, so that `keep_code` need not be called for it."""
        return self._code(digest).is_file()

    def code(self, digest: str) -> dict[str, Any] | None:
        """The `digest` and `definitions` of each module that a digest of code stands for; None if unknown."""
        content = read_checksummed(self._code(digest))
        return content["modules"] if content else None

    def _code(self, digest: str) -> Path:
        return self.root / "code" / f"{digest}.json"
