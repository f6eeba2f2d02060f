"""A store in a bucket: every result of it that is used on this machine is copied to a local store, the mirror.

    actions/<key>.json               the record of an action
    manifests/ files/                artifacts: see `remote_artifacts`
    code/ runs/ logs/ pins/          as in a local store
    damaged/                         damaged records, and manifests of damaged artifacts, whose files stay in place

A bucket has neither renaming nor locks. So an action is done as soon as its record is there. The record is put after
the artifacts, and only if there is none yet: the second of two writers takes the record of the first.

Stages work on the mirror. A result that could not be put into the bucket is put there when it is next asked for. An
artifact is fetched whole when it is first needed, and moved into the mirror once every byte of it has been checked.
Locks, checkpoints, declarations, the files behind a digest and the links in `latest` exist only in the mirror. So on
one machine, each action is done once; two machines may both do an action at the same time, and one result counts; and
an action that was interrupted on one machine starts over on another.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from platformdirs import user_cache_path

from pipeline.artifact import Artifact, ArtifactWriter, publish
from pipeline.canonical import Json
from pipeline.errors import CorruptArtifact, RemoteError
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.bucket.remote_artifacts import RemoteArtifacts
from pipeline.store.bucket.remote_damaged import RemoteDamaged, damaged_record_name
from pipeline.store.bucket.remote_history import RemoteHistory
from pipeline.store.bucket.remote_pins import RemotePins
from pipeline.store.checksummed import write_text_whole
from pipeline.store.damaged import ACTIONS, name_in_damaged
from pipeline.store.history import History
from pipeline.store.pins import Pins
from pipeline.store.record import RECORD, Record, is_digest, read_record
from pipeline.store.store import Store, Young

CACHE = "GS_HIDER_CACHE"
UNSENT = "unsent"
"""The mirror's folder with an empty file, named after the key, for each action whose result has yet to be put."""
SPARED = 86400.0  # seconds for which `gc` spares what was put: no lock reveals runs on other machines
ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL")


def mirror_folder(address: str) -> Path:
    """The folder for copies of a bucket's results on this machine, in $GS_HIDER_CACHE or the user's cache folder.

    Each pair of server and address has its own.
    """
    cache = Path(os.environ[CACHE]) if os.environ.get(CACHE) else user_cache_path("gs-hider")
    server = next((os.environ[name] for name in ENDPOINTS if os.environ.get(name)), "")
    return cache / "stores" / hashlib.sha256(f"{server} {address}".encode()).hexdigest()[:32]


@dataclass(frozen=True)
class _Listing:
    """What a bucket held at one moment."""

    actions: frozenset[str]
    objects: set[str]


class RemoteStore(Store):
    """A store in a bucket. Methods raise RemoteError, or its subclass Unreachable, if the bucket cannot be used."""

    def __init__(self, bucket: Bucket) -> None:
        folder = mirror_folder(bucket.address)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        super().__init__(folder)
        self._mirror = Store(folder)
        self._bucket = bucket
        self._artifacts = RemoteArtifacts(bucket)
        self._listing: _Listing | None = None

    def __repr__(self) -> str:
        return f"RemoteStore({self.address!r})"

    @property
    def address(self) -> str:
        return self._bucket.address

    @property
    def history(self) -> History:
        return RemoteHistory(self.root / "runs", self._bucket)

    @property
    def pins(self) -> Pins:
        return RemotePins(self._bucket)

    @property
    def damaged(self) -> RemoteDamaged:
        return RemoteDamaged(self.root / "damaged", self._bucket, self.temporary)

    @property
    def actions(self) -> frozenset[str]:
        return frozenset(filter(None, map(_key_in, self._bucket.names("actions"))))

    @property
    def objects(self) -> frozenset[str]:
        return self._artifacts.digests

    @property
    def young(self) -> Young:
        """What was put within the last day: a run on another machine may have put it, or have just found it there."""
        actions = self._bucket.listing("actions").items()
        keys = frozenset(filter(None, (_key_in(name) for name, entry in actions if entry.age < SPARED)))
        return Young(keys, self._artifacts.younger_than(SPARED))

    @property
    def remarks(self) -> tuple[str, ...]:
        odd = sorted(self._bucket.odd)
        words = f"{len(odd)} names in the bucket that could lead elsewhere, such as {odd[0]!r}: skipped" if odd else ""
        return (words,) if words else ()

    def holds(self, digest: str) -> bool:
        return self._artifacts.holds(digest)

    def place(self, digest: str) -> str:
        return self._artifacts.place(digest)

    def look(self, workflow: str, stages: Collection[str]) -> None:
        self._listing = _Listing(self.actions, set(self.objects))
        keys = {str(last.made.key) for last in self.history.last(workflow, stages).values() if last.made}
        self._fetch_records(keys & self._listing.actions)

    def find(self, key: str) -> Record | None:
        listing = self._listing
        if listing and key in listing.actions:
            record = self.record(key)
            if record and listing.objects.issuperset(record.outputs.values()):
                return record
        return self._find_in_bucket(key)

    def _find_in_bucket(self, key: str) -> Record | None:
        record = self._fetch_record(key)
        return record if record and all(map(self.holds, record.outputs.values())) else None

    def record(self, key: str) -> Record | None:
        return self._mirror.record(key) or self._fetch_record(key)

    def records(self) -> Iterator[Record]:
        """All readable records, in the order of their keys; those that the mirror lacks are fetched together."""
        keys = self.actions
        self._fetch_records(keys)
        for key in sorted(keys):
            record = self.record(key)
            if record:
                yield record

    def kept_record(self, key: str) -> Record | None:
        return self._record_in_bucket(key, self.temporary())

    def _fetch_record(self, key: str) -> Record | None:
        aside = self.temporary()
        record = self._record_in_bucket(key, aside)
        if record:
            aside.replace(self._record_file(key))
        return record

    def _record_in_bucket(self, key: str, aside: Path) -> Record | None:
        """The record of an action as it is in the bucket, whatever the mirror has; its file is written to `aside`."""
        data = self._bucket.get(_record_name(key)) if is_digest(key) else None
        if data is None:
            return None
        aside.write_bytes(data)
        return read_record(aside, key)

    def _fetch_records(self, keys: Collection[str]) -> None:
        """Fetches those records that the mirror lacks, several at a time."""
        asides = {key: self.temporary() for key in keys if self._mirror.record(key) is None}
        with suppress(FileNotFoundError):  # one was deleted meanwhile; the rest are fetched when asked for
            self._bucket.download({_record_name(key): aside for key, aside in asides.items()})
        for key, aside in asides.items():
            if read_record(aside, key):
                aside.replace(self._record_file(key))

    def _record_file(self, key: str) -> Path:
        return self.folder("actions", key) / RECORD

    def artifact(self, digest: str) -> Artifact:
        """The local copy of an artifact, which is fetched if there is none.

        Raises CorruptArtifact if the artifact is missing or damaged in the bucket.
        """
        return self._whole_copy(digest) or self._fetch(digest)

    def check_object(self, digest: str) -> int:
        """Reads every byte of an artifact in the bucket; sets a damaged copy here aside without reporting it."""
        self._mirror.set_aside(digest)
        aside = self.temporary()
        try:
            artifact = self._artifacts.fetch(digest, aside)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        return sum(file.size for file in artifact.manifest.files.values())

    def foreign(self, digest: str) -> tuple[str, ...]:
        """Always empty: of an artifact in a bucket, only what its manifest names is fetched."""
        return ()

    def is_sound(self, digest: str) -> bool:
        """Whether the copy here, fetched if missing, is sound; sets a damaged one aside, to be fetched anew later."""
        if super().is_sound(digest):
            return True
        self._mirror.set_aside(digest)
        return False

    def _whole_copy(self, digest: str) -> Artifact | None:
        try:
            artifact = self._mirror.artifact(digest)
            artifact.check_sizes()
        except CorruptArtifact:
            return None
        return artifact

    def _fetch(self, digest: str) -> Artifact:
        with self.lock(f"fetch-{digest}"):
            there = self._whole_copy(digest)
            if there:  # another process was first
                return there
            artifact = self._artifacts.fetch(digest, self.temporary())
            if self.object(digest).exists():
                self.object(digest).rename(self.temporary())
            self.folder("objects")
            return publish(artifact, self.object(digest))

    def set_aside(self, digest: str) -> None:
        """Withdraws an artifact that is damaged in the bucket; a sound copy here takes its place, if there is one.

        If only the copy here is damaged, it is fetched again.
        """
        self._mirror.set_aside(digest)
        copy = self._whole_copy(digest)
        try:
            if copy:
                self.check_object(digest)
            else:
                self._fetch(digest)
        except CorruptArtifact:
            self._artifacts.withdraw(digest)
            if copy:
                self._artifacts.put(copy)
            elif self._listing:
                self._listing.objects.discard(digest)

    def remains(self, key: str) -> tuple[str, ...]:
        names = (_record_name(key), damaged_record_name(key))
        return tuple(f"{self.address}/{name}" for name in names if self._bucket.get(name) is not None)

    def set_record_aside(self, key: str) -> None:
        """Moves a damaged record to `damaged`; a sound copy here takes its place if the bucket has its artifacts."""
        altered = self.kept_record(key) is None
        self.damaged.take_record(key, _record_name(key))
        copy = self._mirror.record(key)
        self._bucket.delete([_record_name(key)])
        if altered and copy and all(map(self.holds, copy.outputs.values())):
            self._put_record(copy)
        else:
            self._mirror.set_record_aside(key)

    def put_back(self) -> tuple[str, ...]:
        """Puts into the bucket what was withdrawn there as damaged, and of which the copies here are sound."""
        restored = []
        for key in sorted(self._withdrawn() - self.actions):
            made = self._mirror.find(key)
            if made and all(self._mirror.is_sound(digest) for digest in made.outputs.values()):
                self._send(made, self.root / UNSENT / key)
                restored.append(key)
        return tuple(restored)

    def _withdrawn(self) -> set[str]:
        """The keys of the records that were set aside in the bucket."""
        names = self._bucket.names(f"damaged/{ACTIONS}")
        return {key for name in names if is_digest(key := name_in_damaged(name))}

    def commit(
        self, key: str, parts: Mapping[str, Json], writers: Mapping[str, ArtifactWriter], provenance: Mapping[str, Any]
    ) -> Record:
        """As in a local store. If it breaks off, nothing of the action is visible, and `send_late` resumes it."""
        mark = self.folder(UNSENT) / key
        if not mark.exists() and self._bucket.get(_record_name(key)) is None:
            self._mirror.set_record_aside(key)  # was deleted from the bucket, maybe to give up a key
        mark.touch(mode=0o600)
        return self._send(self._mirror.commit(key, parts, writers, provenance), mark)

    def send_late(self, key: str) -> Record | None:
        """Resumes an interrupted `commit`, and returns the record; None if there was none.

        A result that is only here, but was not left by a `commit`, was deleted from the bucket and no longer counts.
        """
        mark = self.root / UNSENT / key
        made = self._mirror.find(key) if mark.is_file() else None
        return self._send(made, mark) if made else None

    def _send(self, made: Record, mark: Path) -> Record:
        for digest in made.outputs.values():
            self._artifacts.put(self._mirror.artifact(digest))
        self._put_code(str(made.parts.get("code")))
        first = self._put_record(made)
        mark.unlink(missing_ok=True)
        return first

    def add(self, record: Record) -> None:
        self._mirror.add(record)
        self._put_code(str(record.parts.get("code")))
        self._put_record(record)

    def _put_record(self, made: Record) -> Record:
        """Puts a record of the mirror into the bucket; if another machine was first, returns its record instead."""
        data = self._record_file(made.key).read_bytes()
        while not self._bucket.create(_record_name(made.key), data):
            first = self._find_in_bucket(made.key)
            if first:
                return first
            self._bucket.delete([_record_name(made.key)])  # its artifacts are damaged or gone
        return made

    def _put_code(self, digest: str) -> None:
        """Puts a list of code where other machines can use it to explain a result. Planning alone puts nothing."""
        with suppress(RemoteError, FileNotFoundError):  # it only costs an explanation
            self._bucket.create(_code_name(digest), self._code(digest).read_bytes())

    def code(self, digest: str) -> dict[str, Any] | None:
        modules = self._mirror.code(digest)
        if modules is not None:
            return modules
        data = self._bucket.get(_code_name(digest))
        if data is None:
            return None
        self.folder("code")
        write_text_whole(self._code(digest), data.decode(errors="replace"), self.temporary())
        return self._mirror.code(digest)

    def latest_digests(self) -> dict[str, str]:
        """The digests of what each stage last made, on any machine, as far as they are still in the bucket.

        Journals come first; the links here add what no journal says.
        """
        names = self._mirror.latest_digests() | self.history.latest_digests()
        objects = self.objects
        return {name: digest for name, digest in sorted(names.items()) if digest in objects}

    def keep_log(self, path: Path) -> None:
        with suppress(RemoteError, FileNotFoundError):  # the log is still here; other calls report the error
            self._bucket.put(path.relative_to(self.root).as_posix(), path.read_bytes())

    def delete_record(self, key: str) -> None:
        """Deletes the record of an action, in the bucket and here."""
        self._bucket.delete([_record_name(key)])
        self._mirror.delete_record(key)

    def delete_object(self, digest: str) -> None:
        """Deletes an artifact, in the bucket and here."""
        if self._listing:
            self._listing.objects.discard(digest)
        self._artifacts.delete(digest)
        self._mirror.delete_object(digest)

    def sizes_of_records(self, keys: Collection[str]) -> dict[str, int]:
        sizes = self._bucket.names("actions")
        return {key: sizes.get(_record_name(key), 0) for key in keys}

    def sizes_of_objects(self, digests: Collection[str]) -> dict[str, int]:
        return self._artifacts.sizes(digests) if digests else {}

    def entries(self, folder: str) -> dict[str, int]:
        """The entries of a folder, in the bucket and in the mirror together."""
        sizes: Counter[str] = Counter()
        for name, size in self._bucket.names(folder).items():
            sizes[f"{folder}/{name.removeprefix(f'{folder}/').split('/')[0]}"] += size
        return self._mirror.entries(folder) | dict(sorted(sizes.items()))

    def delete_entry(self, name: str) -> None:
        """Deletes an entry by its name in `entries`, in the bucket and here. Raises as in a local store."""
        self._bucket.delete([name, *self._bucket.names(name)])
        self._mirror.delete_entry(name)

    def abandoned(self) -> dict[str, int]:
        """Files of uploads that broke off at least a day ago, and copies here of what is no longer in the bucket.

        Copies of what was withdrawn as damaged stay: they may be the only sound ones, which `put_back` restores.
        """
        actions, objects = self.actions, self.objects
        copies = self._mirror.entries("actions") | self._mirror.entries("objects")
        unsent = {name.rpartition("/")[2] for name in self._mirror.entries(UNSENT)}
        sound = unsent | self._withdrawn()
        made = [record for key in sound if (record := self._mirror.find(key))]
        here = actions | objects | sound | {digest for record in made for digest in record.outputs.values()}
        lone = {name: size for name, size in copies.items() if name.rpartition("/")[2] not in here}
        return self._artifacts.unfinished(SPARED) | lone


def _record_name(key: str) -> str:
    return f"actions/{key}.json"


def _code_name(digest: str) -> str:
    return f"code/{digest}.json"


def _key_in(name: str) -> str | None:
    """The key of the action whose record has this name in the bucket; None for any other name."""
    path = PurePosixPath(name)
    return path.stem if path.parent.name == "actions" and path.suffix == ".json" and is_digest(path.stem) else None
