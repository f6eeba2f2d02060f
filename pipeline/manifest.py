"""The manifest of an artifact: its logical content (identity) and every file that it consists of (integrity).

Identity is the digest of the logical content: kind, privacy, attributes, the name, type, shape and little-endian bytes
of each array, and the name and bytes of each plain file. How zarr chunks and compresses arrays does not enter it.
Integrity covers the bytes on disk: size and SHA-256 of every file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from pipeline.canonical import Json, digest_of, digest_of_file, plain
from pipeline.disk import parse_json, read_plain_file
from pipeline.errors import ArtifactError, CorruptArtifact

Typed = TypeVar("Typed")

MANIFEST = "manifest.json"
ARRAYS = "arrays.zarr"
FORMAT = 1


@dataclass(frozen=True)
class ArrayRecord:
    """One array: NumPy's type code, shape, shape of a chunk, and SHA-256 of its little-endian bytes in C order."""

    dtype: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    sha256: str


@dataclass(frozen=True)
class FileRecord:
    """One file on disk; a chunk of an array is one, too. `size` is in bytes."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """What `manifest.json` says about an artifact."""

    kind: str
    private: bool
    attributes: Mapping[str, Json]
    arrays: Mapping[str, ArrayRecord]
    files: Mapping[str, FileRecord] = field(default_factory=dict)

    @property
    def plain_files(self) -> tuple[str, ...]:
        """Names of the files that are not part of an array, sorted."""
        return tuple(sorted(name for name in self.files if PurePosixPath(name).parts[0] != ARRAYS))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the logical content."""
        return digest_of(
            {
                "format": FORMAT,
                "kind": self.kind,
                "private": self.private,
                "attributes": self.attributes,
                "arrays": {name: [array.dtype, array.shape, array.sha256] for name, array in self.arrays.items()},
                "files": {name: self.files[name].sha256 for name in self.plain_files},
            },
            "the artifact",
        )

    def write(self, directory: Path) -> None:
        """Writes `manifest.json` into `directory`, without flushing it to disk."""
        content = {"format": FORMAT, "digest": self.digest, **asdict(self)}
        (directory / MANIFEST).write_text(json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n")


def read_manifest(directory: Path) -> Manifest:
    """The manifest in `directory`. Raises CorruptArtifact if it is missing, malformed, altered or of another format."""
    path = directory / MANIFEST
    try:
        content = parse_json(read_plain_file(path))
        if content["format"] != FORMAT:
            raise CorruptArtifact(f"{path}: format {content['format']}; this program reads format {FORMAT}")
        manifest = Manifest(
            kind=_of_type(content["kind"], str),
            private=_of_type(content["private"], bool),
            attributes=_of_type(content["attributes"], dict),
            arrays={name: _array_record(record) for name, record in content["arrays"].items()},
            files={name: _file_record(record) for name, record in content["files"].items()},
        )
        for name in (*manifest.arrays, *manifest.files):
            check_name(name)
        if manifest.digest != content["digest"]:
            raise CorruptArtifact(f"{path}: its content does not match the digest that it states")
    except OSError as error:
        raise CorruptArtifact(f"{directory}: no readable {MANIFEST} ({error.strerror})") from error
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, ArtifactError) as error:
        if isinstance(error, CorruptArtifact):
            raise
        raise CorruptArtifact(f"{path}: not a manifest ({error})") from error
    return manifest


def survey(directory: Path) -> dict[str, FileRecord]:
    """Size and SHA-256 of every file under `directory` except the manifest, sorted by name.

    Raises ArtifactError for anything but plain files and folders.
    """
    records = {}
    for path in sorted(directory.rglob("*")):
        name = path.relative_to(directory).as_posix()
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise ArtifactError(f"{name}: an artifact may contain only plain files and folders")
        if path.is_file() and name != MANIFEST:
            records[name] = FileRecord(path.stat().st_size, digest_of_file(path))
    return records


def check_name(name: str) -> None:
    """Raises ArtifactError unless `name` is a relative path with `/` that stays inside the artifact.

    >>> check_name("scene_decoder/0.weight")
    """
    parts = name.split("/")
    if not name or "\\" in name or "\0" in name or any(part in ("", ".", "..") for part in parts):
        raise ArtifactError(f"{name!r} cannot name part of an artifact; expected a relative path such as 'a/b'")


def check_attributes(attributes: Mapping[str, Json]) -> dict[str, Json]:
    """A copy of `attributes` as plain JSON data. Raises ArtifactError for values that JSON cannot represent."""
    try:
        return {name: plain(value, f"attribute {name!r}") for name, value in attributes.items()}
    except (TypeError, ValueError) as error:
        raise ArtifactError(str(error)) from error


def sha256(data: bytes | memoryview) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def _array_record(record: Any) -> ArrayRecord:
    return ArrayRecord(
        _of_type(record["dtype"], str), tuple(record["shape"]), tuple(record["chunks"]), _of_type(record["sha256"], str)
    )


def _file_record(record: Any) -> FileRecord:
    return FileRecord(_of_type(record["size"], int), _of_type(record["sha256"], str))


def _of_type(value: Any, expected: type[Typed]) -> Typed:
    if type(value) is not expected:
        raise TypeError(f"{value!r:.60} is not of type {expected.__name__}")
    return value
