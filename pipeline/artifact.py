"""Artifacts: immutable directories of zarr arrays and plain files, with a manifest of everything in them.

    <artifact>/manifest.json     kind, privacy, attributes, arrays, and every file's size and SHA-256
    <artifact>/arrays.zarr/…     the arrays, one zarr group, Zstandard with a checksum in each chunk
    <artifact>/report.html …     plain files, under the names that the stage gave them

Nothing here is ever unpickled: loading a stranger's artifact is safe. zarr is imported only where it is used: the
import takes half a second, which a run with nothing to do should not spend.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pipeline.arrays import check_array
from pipeline.canonical import Json, digest_of_file
from pipeline.disk import flush, is_link, size_of_plain_file
from pipeline.errors import ArtifactError, CorruptArtifact
from pipeline.manifest import (
    ARRAYS,
    MANIFEST,
    ArrayRecord,
    Manifest,
    check_attributes,
    check_name,
    read_manifest,
    sha256,
    survey,
)

if TYPE_CHECKING:
    import numpy as np
    import zarr

ROWS_OF_A_CHUNK = 65536
LARGE_ROW = 16 * 1024  # bytes; an item of this size along axis 0 (a picture, not a matrix) is a chunk of its own
LARGEST_CHUNK = 64 * 1024 * 1024  # bytes


class Artifact:
    """An immutable artifact. Opening it reads only the manifest; reading an array or file checks that it is whole."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path = path
        self.manifest = manifest

    def __repr__(self) -> str:
        return f"Artifact({self.kind!r}, {str(self.path)!r})"

    @property
    def kind(self) -> str:
        """What it is, such as `container`."""
        return self.manifest.kind

    @property
    def private(self) -> bool:
        """Whether only its owner may see the content."""
        return self.manifest.private

    @property
    def digest(self) -> str:
        """SHA-256 of the logical content."""
        return self.manifest.digest

    @property
    def attributes(self) -> Mapping[str, Json]:
        """The JSON values that the stage set."""
        return self.manifest.attributes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays, sorted."""
        return tuple(sorted(self.manifest.arrays))

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the plain files, sorted."""
        return self.manifest.plain_files

    def open(self, name: str) -> zarr.Array:
        """The array `name`, open for reading slices; nothing of it is read yet.

        Raises ArtifactError if there is no such array, CorruptArtifact if a chunk is missing or truncated: zarr itself
        would return zeros for it.
        """
        import zarr

        if name not in self.manifest.arrays:
            raise ArtifactError(f"{self.path}: no array {name!r}; this {self.kind} holds {', '.join(self.names)}")
        prefix = f"{ARRAYS}/{name}/"
        self._check_folders()
        for file in self.manifest.files:
            if file.startswith(prefix):
                self._check_size(file)
        self._check_content(f"{prefix}zarr.json")  # chunks have checksums of their own, their description has none
        check_array(self.path, self.manifest, name)
        try:
            return zarr.open_array(self.path / ARRAYS / name, mode="r", zarr_format=3)
        except OSError as error:  # another run has just set it aside
            raise CorruptArtifact(f"{self.path}: array {name!r} cannot be opened ({error})") from error

    def read(self, name: str) -> np.ndarray:
        """The whole array `name`, in memory. Raises as `open` does, and CorruptArtifact for a flipped bit."""
        values = self._part(name, self.open(name), ...)
        if sha256_of_array(values) != self.manifest.arrays[name].sha256:
            raise CorruptArtifact(f"{self.path}: array {name!r} does not hold the numbers that were written")
        return values

    def blocks(self, name: str) -> Iterator[np.ndarray]:
        """Yields the array `name` chunk by chunk, so that it may be larger than memory.

        Raises as `open` does, and CorruptArtifact for a chunk that does not match its checksum.
        """
        array = self.open(name)
        starts = [range(0, size, chunk) for size, chunk in zip(array.shape, array.chunks, strict=True)]
        for corner in itertools.product(*starts):
            ends = [start + chunk for start, chunk in zip(corner, array.chunks, strict=True)]
            yield self._part(name, array, tuple(map(slice, corner, ends)))

    def item(self, name: str, index: tuple[int, ...]) -> np.ndarray:
        """The part of the array `name` at `index` along its first axes. Raises as `blocks` does."""
        return self.parts(name)(index)

    def parts(self, name: str) -> Callable[[object], np.ndarray]:
        """A function that reads a part of the array `name`, given by an index or slices.

        For reading many parts: the array is checked only once, since the check takes longer than reading a picture.
        Raises as `open` does; the function raises CorruptArtifact for a damaged chunk, or if the artifact has
        disappeared meanwhile.
        """
        array = self.open(name)

        def read(part: object) -> np.ndarray:
            values = self._part(name, array, part)
            if not (self.path / MANIFEST).is_file():  # another run has set it aside: zarr returned zeros
                raise CorruptArtifact(f"{self.path}: disappeared while array {name!r} was being read")
            return values

        return read

    def _part(self, name: str, array: zarr.Array, part: object) -> np.ndarray:
        import numpy as np

        try:
            return np.asarray(array[part])
        except (OSError, RuntimeError, ValueError) as error:  # the last two: the decoder's complaints about a checksum
            raise CorruptArtifact(f"{self.path}: array {name!r} cannot be read ({error})") from error

    def file(self, name: str) -> Path:
        """The path of the plain file `name`, after checking its bytes.

        Raises ArtifactError if there is no such file, CorruptArtifact if it is missing or altered.
        """
        if name not in self.files:
            raise ArtifactError(f"{self.path}: no file {name!r}; this {self.kind} holds {', '.join(self.files)}")
        self._check_content(name)
        return self.path / name

    def verify(self) -> None:
        """Reads every byte; raises CorruptArtifact naming the first file that is missing or altered.

        Foreign files do no harm, since nothing reads them: see `foreign`.
        """
        self._check_folders()
        for name in self.manifest.files:
            self._check_content(name)
        for name in self.manifest.arrays:
            check_array(self.path, self.manifest, name)

    def check_sizes(self) -> None:
        """Raises CorruptArtifact naming the first file that is missing or has the wrong size; reads no content."""
        self._check_folders()
        for name in self.manifest.files:
            self._check_size(name)

    def foreign(self) -> tuple[str, ...]:
        """Names of files and links that something else put here, such as a file browser. Raises OSError."""
        own = {MANIFEST, *self.manifest.files}
        found = [path for path in sorted(self.path.rglob("*")) if path.is_symlink() or not path.is_dir()]
        names = [path.relative_to(self.path).as_posix() for path in found]
        return tuple(name for name in names if name not in own)

    def _check_folders(self) -> None:
        """Raises CorruptArtifact for a folder that is a link: it could lead to anyone's files."""
        for folder in {parent for name in self.manifest.files for parent in PurePosixPath(name).parents}:
            if is_link(self.path / folder):
                raise CorruptArtifact(f"{self.path / folder}: a link; expected a folder")

    def _check_content(self, name: str) -> None:
        if name not in self.manifest.files:
            raise CorruptArtifact(f"{self.path}: its manifest does not name {name!r}")
        self._check_size(name)
        try:
            digest = digest_of_file(self.path / name)
        except OSError as error:
            raise CorruptArtifact(f"{self.path / name}: cannot be read ({error.strerror})") from error
        if digest != self.manifest.files[name].sha256:
            raise CorruptArtifact(f"{self.path / name}: altered since it was written")

    def _check_size(self, name: str) -> None:
        size, expected = size_of_plain_file(self.path / name), self.manifest.files[name].size
        if size is None:
            raise CorruptArtifact(f"{self.path / name}: missing")
        if size != expected:
            raise CorruptArtifact(f"{self.path / name}: {size} bytes; expected {expected}")


class ArtifactWriter:
    """Fills the directory of a new artifact; set `attributes` at any time before the stage returns."""

    def __init__(self, path: Path, kind: str, private: bool = False) -> None:
        self.path = path
        self.kind = kind
        self.private = private
        self.attributes: dict[str, Json] = {}
        self._arrays: dict[str, ArrayRecord] = {}
        path.mkdir(parents=True, mode=0o700 if private else 0o777)
        if private:
            path.chmod(0o700)

    def write(self, name: str, array: np.ndarray, chunks: tuple[int, ...] | None = None) -> None:
        """Writes a whole array under `name`, which may contain `/`.

        `chunks` is the shape of a chunk, at most that of the array. By default a large item along axis 0 (a picture) is
        a chunk of its own, and up to 65,536 smaller items share one, in at most 64 MiB. Raises ArtifactError for types
        other than booleans, integers and floating-point or complex numbers, and for a name that is invalid or taken.
        """
        import numpy as np
        import zarr
        from zarr.codecs import ZstdCodec

        check_name(name)
        array = np.asarray(array, order="C")
        if array.dtype.kind not in "biufc":
            raise ArtifactError(f"array {name!r} is of type {array.dtype}; expected numbers or booleans")
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        if name in self._arrays:
            raise ArtifactError(f"array {name!r} is written twice")
        chunks = chunks if chunks is not None else default_chunks(array.shape, array.dtype.itemsize)
        chunks = tuple(min(chunk, max(1, size)) for chunk, size in zip(chunks, array.shape, strict=True))
        group = zarr.open_group(self.path / ARRAYS, mode="a")
        stored = group.create_array(
            name,
            shape=array.shape,
            dtype=array.dtype,
            chunks=chunks,
            compressors=[ZstdCodec(level=3, checksum=True)],
            fill_value=0,
            config={"write_empty_chunks": True},  # otherwise a deleted chunk would look like one of zeros
        )
        stored[...] = array
        self._arrays[name] = ArrayRecord(array.dtype.str, array.shape, chunks, sha256_of_array(array))

    def write_file(self, name: str, data: bytes | str) -> None:
        """Writes a plain file; text is written as UTF-8. Raises as `path_for` does."""
        self.path_for(name).write_bytes(data.encode() if isinstance(data, str) else data)

    def path_for(self, name: str) -> Path:
        """Where a library can write the plain file `name` itself; its folder exists on return.

        Raises ArtifactError for a name that is invalid or reserved by the engine.
        """
        check_name(name)
        if name.split("/")[0] in (MANIFEST, ARRAYS):
            raise ArtifactError(f"{name!r} is reserved for the engine; choose another name")
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    @property
    def untouched(self) -> bool:
        """Whether nothing has been written and no attribute set."""
        return not self._arrays and not self.attributes and not any(self.path.iterdir())

    def finish(self) -> Artifact:
        """Writes the manifest, flushes everything to disk and returns the artifact, still where it was written.

        Raises ArtifactError for attributes that are not JSON.
        """
        manifest = Manifest(self.kind, self.private, check_attributes(self.attributes), self._arrays, survey(self.path))
        manifest.write(self.path)
        hidden = 0o077 if self.private else user_mask()
        for path in (self.path, *self.path.rglob("*")):
            path.chmod((0o777 if path.is_dir() else 0o666) & ~hidden)
            flush(path)
        return Artifact(self.path, manifest)


@contextmanager
def create(directory: Path, kind: str, private: bool = False) -> Iterator[ArtifactWriter]:
    """Writes an artifact aside and renames it to `directory` on exit; leaves nothing behind after an exception.

    An artifact that is already there stays.
    """
    aside = directory.parent / f".{directory.name}.{uuid.uuid4().hex}"
    writer = ArtifactWriter(aside, kind, private)
    try:
        yield writer
        publish(writer.finish(), directory)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def load(path: Path) -> Artifact:
    """The artifact at `path`. Raises CorruptArtifact if there is none, or if its manifest is damaged."""
    return Artifact(path, read_manifest(path))


def publish(artifact: Artifact, directory: Path) -> Artifact:
    """Renames a finished artifact to `directory`, on the same file system, atomically and durably.

    If an artifact is already there, that one stays and the new one is deleted.
    """
    try:
        artifact.path.rename(directory)
    except OSError:
        if not (directory / MANIFEST).is_file():
            raise
        shutil.rmtree(artifact.path)
    flush(directory.parent)
    return load(directory)


def default_chunks(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """The default shape of a chunk; never 0 along an axis.

    >>> default_chunks((48, 144, 192, 3), 1), default_chunks((200_000, 16), 4), default_chunks((48, 4, 4), 8)
    ((1, 144, 192, 3), (65536, 16), (48, 4, 4))
    """
    if not shape:
        return ()
    row = max(1, math.prod(shape[1:]) * itemsize)
    rows = 1 if len(shape) >= 3 and row >= LARGE_ROW else min(shape[0], ROWS_OF_A_CHUNK, max(1, LARGEST_CHUNK // row))
    return tuple(max(1, size) for size in (rows, *shape[1:]))


def sha256_of_array(array: np.ndarray) -> str:
    """SHA-256 of the array's little-endian bytes in C order, in hexadecimal."""
    import numpy as np

    array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    return sha256(array.reshape(-1).view("u1").data)


def user_mask() -> int:
    """The user's umask: the permissions that new files do not get."""
    mask = os.umask(0o077)  # it can only be read by setting it
    os.umask(mask)
    return mask
