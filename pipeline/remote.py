"""A store in a bucket: every result of it that is used here has a copy in a local store, the mirror.

    actions/<key>.json               the record of an action
    manifests/<digest>.json          the manifest of an artifact
    files/<digest>/<sha256>          its files, each under the hash of its bytes
    code/ runs/ logs/                as in a local store

A bucket knows neither renaming nor locks. So an artifact is there when its manifest is, which is put after all its
files; files are named after their bytes, so that two who write one artifact write the same; and an action is done when
its record is, which is put last and only where there is none yet: whoever comes second takes the record of the first.
An upload that breaks off leaves nothing but files without a manifest, which `gc` may delete.

Stages work on the mirror. An artifact is fetched whole when it is first needed, and is moved into the mirror when every
byte of it has been checked. Locks, checkpoints, declarations and `latest` are the mirror's alone: on one machine each
action is done once; two machines at the same time may both do one, of which one result counts; and what was
interrupted on one machine begins anew on another.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from pipeline.artifact import Artifact, ArtifactWriter, publish
from pipeline.bucket import Bucket
from pipeline.canonical import Json
from pipeline.errors import CorruptArtifact, RemoteError
from pipeline.history import History
from pipeline.manifest import MANIFEST, read_manifest
from pipeline.remote_history import RemoteHistory
from pipeline.store import RECORD, Record, Store, write_text_whole

CACHE = "GS_HIDER_CACHE"
ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL")


def open_store(address: str | Path) -> Store:
    """The store at an address: a folder, or `s3://BUCKET/PREFIX`. Raises CommandError for what is no address."""
    if "://" not in str(address):
        return Store(Path(address))
    return RemoteStore(Bucket(str(address)))


def mirror_folder(address: str) -> Path:
    """Where copies of a bucket's results lie on this machine: under $GS_HIDER_CACHE, or the user's own cache folder."""
    cache = Path(os.environ[CACHE]) if os.environ.get(CACHE) else user_cache_path("gs-hider")
    server = next((os.environ[name] for name in ENDPOINTS if os.environ.get(name)), "")
    return cache / "stores" / hashlib.sha256(f"{server} {address}".encode()).hexdigest()[:32]


@dataclass(frozen=True)
class _Listing:
    """What was in a bucket at one moment."""

    actions: frozenset[str]
    objects: set[str]


class RemoteStore(Store):
    """A store in a bucket. Methods raise RemoteError, or Unreachable, where the bucket cannot be used."""

    def __init__(self, bucket: Bucket) -> None:
        folder = mirror_folder(bucket.address)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        super().__init__(folder)
        self._mirror = Store(folder)
        self._bucket = bucket
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
    def actions(self) -> frozenset[str]:
        return frozenset(_stem(name) for name in self._bucket.names("actions"))

    @property
    def objects(self) -> frozenset[str]:
        return frozenset(_stem(name) for name in self._bucket.names("manifests"))

    def look(self, workflow: str, stages: Collection[str]) -> None:
        self._listing = _Listing(self.actions, set(self.objects))
        keys = {str(last.made.key) for last in self.history.last(workflow, stages).values() if last.made}
        lacking = [key for key in keys & self._listing.actions if self._mirror.record(key) is None]
        asides = {key: self.temporary() for key in lacking}
        with suppress(FileNotFoundError):  # deleted meanwhile; the others are asked for one by one
            self._bucket.download({_record_name(key): aside for key, aside in asides.items()})
        for key, aside in asides.items():
            if aside.is_file():
                aside.replace(self._record_file(key))

    def find(self, key: str) -> Record | None:
        listing = self._listing
        if listing and key in listing.actions:
            record = self.record(key)
            if record and listing.objects.issuperset(record.outputs.values()):
                return record
        record = self._fetch_record(key)
        return record if record and all(self._is_there(digest) for digest in record.outputs.values()) else None

    def record(self, key: str) -> Record | None:
        return self._mirror.record(key) or self._fetch_record(key)

    def _fetch_record(self, key: str) -> Record | None:
        data = self._bucket.get(_record_name(key))
        if data is None:
            return None
        write_text_whole(self._record_file(key), data.decode(errors="replace"), self.temporary())
        return self._mirror.record(key)

    def _record_file(self, key: str) -> Path:
        return self.folder("actions", key) / RECORD

    def _is_there(self, digest: str) -> bool:
        return self._bucket.get(_manifest_name(digest)) is not None

    def artifact(self, digest: str) -> Artifact:
        """Raises CorruptArtifact where it is missing or damaged in the bucket; fetches it where it is not here yet."""
        return self._whole_copy(digest) or self._fetch(digest)

    def is_sound(self, digest: str) -> bool:
        """Of the copy here, every byte of it; a damaged one is dropped, so that it is fetched when next asked for."""
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
            artifact = self._fetched(digest)
            if self.object(digest).exists():
                self.object(digest).rename(self.temporary())
            self.folder("objects")
            return publish(artifact, self.object(digest))

    def _fetched(self, digest: str) -> Artifact:
        """The artifact, fetched and checked, in a temporary folder."""
        where = f"{self.address}/{_manifest_name(digest)}"
        manifest_data = self._bucket.get(_manifest_name(digest))
        if manifest_data is None:
            raise CorruptArtifact(f"{where}: missing")
        aside = self.temporary()
        aside.mkdir(mode=0o700)
        (aside / MANIFEST).write_bytes(manifest_data)
        manifest = read_manifest(aside)
        if manifest.digest != digest:
            raise CorruptArtifact(f"{where}: the manifest of another artifact, {manifest.digest}")
        for name in manifest.files:
            (aside / name).parent.mkdir(parents=True, exist_ok=True)
        names: dict[str, list[str]] = {}
        for name, file in manifest.files.items():
            names.setdefault(_file_name(digest, file.sha256), []).append(name)
        try:
            self._bucket.download({source: aside / copies[0] for source, copies in names.items()})
        except FileNotFoundError:
            raise CorruptArtifact(f"{where}: a file of this artifact is missing") from None
        for first, *others in names.values():
            for other in others:
                (aside / other).write_bytes((aside / first).read_bytes())
        artifact = Artifact(aside, manifest)
        artifact.verify()
        for path in (aside, *aside.rglob("*")):
            everybody = 0o755 if path.is_dir() else 0o644
            path.chmod(everybody & 0o700 if manifest.private else everybody)
        return artifact

    def set_aside(self, digest: str) -> None:
        """Takes an artifact out of the bucket that is damaged there; where only the copy here was, it is renewed."""
        self._mirror.set_aside(digest)
        try:
            self._fetch(digest)
        except CorruptArtifact:
            self._forget(digest)
            self._bucket.delete([_manifest_name(digest)])

    def _forget(self, digest: str) -> None:
        if self._listing:
            self._listing.objects.discard(digest)

    def commit(
        self, key: str, parts: Mapping[str, Json], writers: Mapping[str, ArtifactWriter], provenance: Mapping[str, Any]
    ) -> Record:
        """As in a local store. If it breaks off, nothing of the action can be seen."""
        made = self._mirror.commit(key, parts, writers, provenance)
        for digest in made.outputs.values():
            self._push(digest)
        data = self._record_file(key).read_bytes()
        while not self._bucket.create(_record_name(key), data):
            first = self.find(key)
            if first:
                return first
            self._bucket.delete([_record_name(key)])  # one whose artifacts are damaged or gone
        return made

    def _push(self, digest: str) -> None:
        """Puts an artifact of the mirror into the bucket, unless it is there, whole as far as sizes tell."""
        artifact = self._mirror.artifact(digest)
        manifest_data = (artifact.path / MANIFEST).read_bytes()
        files = {
            _file_name(digest, file.sha256): artifact.path / name for name, file in artifact.manifest.files.items()
        }
        if self._bucket.get(_manifest_name(digest)) == manifest_data:
            sizes = self._bucket.names(f"files/{digest}")
            if all(sizes.get(name) == path.stat().st_size for name, path in files.items()):
                return
        self._bucket.upload(files)
        self._bucket.put(_manifest_name(digest), manifest_data)

    def keep_code(self, digest: str, modules: Mapping[str, str], definitions: Mapping[str, Mapping[str, str]]) -> None:
        self._mirror.keep_code(digest, modules, definitions)
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

    def keep_log(self, path: Path) -> None:
        with suppress(RemoteError, FileNotFoundError):  # the log is here; what matters more says what went wrong
            self._bucket.put(path.relative_to(self.root).as_posix(), path.read_bytes())

    def delete_record(self, key: str) -> None:
        """Deletes the record of an action, here and in the bucket."""
        self._bucket.delete([_record_name(key)])
        self._mirror.delete_record(key)

    def delete_object(self, digest: str) -> None:
        """Deletes an artifact, here and in the bucket: its manifest first, so that nobody sees a part of it."""
        self._forget(digest)
        self._bucket.delete([_manifest_name(digest)])
        self._bucket.delete(self._bucket.names(f"files/{digest}"))
        self._mirror.delete_object(digest)


def _record_name(key: str) -> str:
    return f"actions/{key}.json"


def _manifest_name(digest: str) -> str:
    return f"manifests/{digest}.json"


def _file_name(digest: str, sha256: str) -> str:
    return f"files/{digest}/{sha256}"


def _code_name(digest: str) -> str:
    return f"code/{digest}.json"


def _stem(name: str) -> str:
    return name.rpartition("/")[2].removesuffix(".json")
