"""Artifacts in a bucket: put whole, and fetched whole with every byte checked.

    manifests/<digest>.json          the manifest of an artifact
    files/<digest>/<sha256>          its files, each under the hash of its bytes

A bucket has no renaming. So an artifact exists as soon as its manifest does, which is put after all its files. Files
are named after their bytes, so that two writers of one artifact write the same. An upload that breaks off leaves
nothing but files without a manifest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from pathlib import Path, PurePosixPath

from pipeline.artifact import Artifact
from pipeline.errors import CorruptArtifact
from pipeline.manifest import MANIFEST, read_manifest
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.record import is_digest

DAMAGED = "damaged/objects"


class RemoteArtifacts:
    """The artifacts of the store in a bucket. Methods raise RemoteError if the bucket cannot be used."""

    def __init__(self, bucket: Bucket) -> None:
        self._bucket = bucket

    @property
    def digests(self) -> frozenset[str]:
        """Digests of all artifacts, whole or not."""
        return frozenset(filter(None, map(_digest_of, self._bucket.names("manifests"))))

    def place(self, digest: str) -> str:
        """Where the files of an artifact are, or would be, in words."""
        return f"{self._bucket.address}/files/{digest}"

    def holds(self, digest: str) -> bool:
        """Whether there is an artifact of that digest, whole or not."""
        return self._bucket.get(_manifest_name(digest)) is not None

    def fetch(self, digest: str, aside: Path) -> Artifact:
        """Writes an artifact to the new folder `aside`. Raises CorruptArtifact if it is incomplete or altered."""
        where = f"{self._bucket.address}/{_manifest_name(digest)}"
        data = self._bucket.get(_manifest_name(digest))
        if data is None:
            raise CorruptArtifact(f"{where}: missing")
        aside.mkdir(mode=0o700)
        (aside / MANIFEST).write_bytes(data)
        try:
            artifact = Artifact(aside, read_manifest(aside))
            if artifact.digest != digest:
                raise CorruptArtifact(f"{where}: the manifest of another artifact, {artifact.digest}")
            self._fetch_files(artifact)
            artifact.verify()
        except CorruptArtifact as error:
            raise CorruptArtifact(str(error).replace(str(aside), self.place(digest))) from None
        for path in (aside, *aside.rglob("*")):
            everybody = 0o755 if path.is_dir() else 0o644
            path.chmod(everybody & 0o700 if artifact.private else everybody)
        return artifact

    def _fetch_files(self, artifact: Artifact) -> None:
        names: dict[str, list[str]] = {}
        for name, file in artifact.manifest.files.items():
            (artifact.path / name).parent.mkdir(parents=True, exist_ok=True)
            names.setdefault(_file_name(artifact.digest, file.sha256), []).append(name)
        try:
            self._bucket.download({source: artifact.path / copies[0] for source, copies in names.items()})
        except FileNotFoundError:
            raise CorruptArtifact(f"{artifact.path}: a file of this artifact is missing") from None
        for first, *others in names.values():
            for other in others:
                (artifact.path / other).write_bytes((artifact.path / first).read_bytes())

    def put(self, artifact: Artifact) -> None:
        """Puts an artifact into the bucket, unless it is there with the same manifest and all its files' sizes."""
        digest = artifact.digest
        data = (artifact.path / MANIFEST).read_bytes()
        files = {
            _file_name(digest, file.sha256): artifact.path / name for name, file in artifact.manifest.files.items()
        }
        if self._bucket.get(_manifest_name(digest)) == data:
            sizes = self._bucket.names(f"files/{digest}")
            if all(sizes.get(name) == path.stat().st_size for name, path in files.items()):
                return
        self._bucket.upload(files)
        self._bucket.put(_manifest_name(digest), data)

    def withdraw(self, digest: str) -> None:
        """Withdraws a damaged artifact by moving its manifest to `damaged`; its files stay as long as that is there."""
        data = self._bucket.get(_manifest_name(digest))
        if data is not None:
            self._bucket.put(f"{DAMAGED}/{digest}.json", data)
        self._bucket.delete([_manifest_name(digest)])

    def delete(self, digest: str) -> None:
        """Deletes an artifact, the manifest first, so that nobody sees a part of it."""
        self._bucket.delete([_manifest_name(digest)])
        self._bucket.delete(self._bucket.names(f"files/{digest}"))

    def sizes(self, digests: Collection[str]) -> dict[str, int]:
        """Bytes of all files of each artifact, damaged or not, by digest; 0 if there are none."""
        sizes = Counter(dict.fromkeys(digests, 0))
        for name, size in {**self._bucket.names("manifests"), **self._bucket.names("files")}.items():
            sizes[_digest_in(name) or ""] += size
        return {digest: sizes[digest] for digest in digests}

    def younger_than(self, seconds: float) -> frozenset[str]:
        """Digests of the artifacts that were put within the last so many seconds."""
        listing = self._bucket.listing("manifests")
        young = (_digest_of(name) for name, entry in listing.items() if entry.age < seconds)
        return frozenset(filter(None, young))

    def unfinished(self, seconds: float) -> dict[str, int]:
        """Folders of files without a manifest, with their bytes, if nothing was put there for so many seconds.

        A manifest in `damaged` counts as one.
        """
        files = self._bucket.listing("files")
        damaged = frozenset(map(_digest_of, self._bucket.names(DAMAGED)))
        whole = damaged | self.digests  # listed last: otherwise an upload that ends meanwhile would count as unfinished
        busy = {_digest_in(name) for name, entry in files.items() if entry.age < seconds}
        sizes: Counter[str] = Counter()
        for name, entry in files.items():
            digest = _digest_in(name)
            if digest and digest not in whole | busy:
                sizes[f"files/{digest}"] += entry.size
        return dict(sizes)


def _manifest_name(digest: str) -> str:
    return f"manifests/{digest}.json"


def _file_name(digest: str, sha256: str) -> str:
    return f"files/{digest}/{sha256}"


def _digest_in(name: str) -> str | None:
    """The digest of the artifact that an object is part of; None for any other object."""
    digest = name.split("/")[1].removesuffix(".json")
    return digest if is_digest(digest) else None


def _digest_of(name: str) -> str | None:
    """The digest of the artifact whose manifest has this name; None for any other name."""
    path = PurePosixPath(name)
    return path.stem if path.suffix == ".json" and is_digest(path.stem) else None
