"""Checks the folder of an array before zarr opens it.

zarr trusts `zarr.json`: codecs by name, shapes of any size. It returns zeros for missing chunks, and a chunk itself
decides how much memory it decompresses into. Artifacts may come from strangers. So only the form that our own writer
produces is read, and a chunk must decompress into exactly the number of bytes that the manifest implies.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
from pathlib import Path
from typing import Any, BinaryIO

from pipeline.disk import parse_json, read_plain_file
from pipeline.errors import CorruptArtifact
from pipeline.manifest import ARRAYS, ArrayRecord, Manifest

DESCRIPTION = "zarr.json"
LARGEST_READ = 2**31  # bytes that a chunk may decompress into
TYPE = re.compile(r"[<|]([biufc])(\d{1,2})")
NAMES = {"b": "bool", "i": "int", "u": "uint", "f": "float", "c": "complex"}
EMPTY = {"b": False, "i": 0, "u": 0, "f": 0.0, "c": [0.0, 0.0]}
"""zarr's fill value, by kind of number."""
HARDEST = 22  # highest compression level of Zstandard
OPTIONAL: dict[str, Any] = {"storage_transformers": [], "dimension_names": None}
"""Entries that some versions of zarr write, with these values, and others leave out."""
ZSTANDARD = b"\x28\xb5\x2f\xfd"
SINGLE_SEGMENT, CHECKSUM, RESERVED_OR_DICTIONARY = 0x20, 0x04, 0x0B
REPEATED_BYTE = 1  # type of a block that stores a single byte
CHECKSUM_BYTES = 4
SIZE_BYTES = {0: 0, 1: 2, 2: 4, 3: 8}  # of a frame's content size field, by its flag


def check_array(directory: Path, manifest: Manifest, name: str) -> None:
    """Raises CorruptArtifact unless the array `name` is stored just as our writer stores it. Decompresses nothing."""
    where = directory / ARRAYS / name
    record = manifest.arrays[name]
    bytes_of_a_chunk = _bytes_of_a_chunk(where, record)
    _check_description(where, record)
    first = f"{ARRAYS}/{name}/c"
    chunks = {file for file in manifest.files if file == first or file.startswith(f"{first}/")}
    counts = [-(-size // chunk) for size, chunk in zip(record.shape, record.chunks, strict=True)]
    if len(chunks) != math.prod(counts):
        raise CorruptArtifact(f"{where}: {len(chunks)} chunks; expected {math.prod(counts)}")
    for indices in itertools.product(*map(range, counts)):
        chunk = "/".join([first, *map(str, indices)])
        if chunk not in chunks:
            raise CorruptArtifact(f"{directory / chunk}: the manifest does not name it")
        _check_chunk(directory / chunk, bytes_of_a_chunk)


def _bytes_of_a_chunk(where: Path, record: ArrayRecord) -> int:
    kind = TYPE.fullmatch(record.dtype)
    sizes = (*record.shape, *record.chunks)
    if not kind or len(record.shape) != len(record.chunks) or any(type(size) is not int or size < 0 for size in sizes):
        raise CorruptArtifact(f"{where}: of type {record.dtype!r} and shape {record.shape}; expected numbers")
    if any(chunk > max(1, size) for size, chunk in zip(record.shape, record.chunks, strict=True)):
        raise CorruptArtifact(f"{where}: chunks of {record.chunks} in a shape of {record.shape}; expected smaller ones")
    size = math.prod(record.chunks) * int(kind[2])
    if not 0 < size <= LARGEST_READ:
        raise CorruptArtifact(f"{where}: {size} bytes in a chunk; expected 1 to {LARGEST_READ}")
    return size


def _check_description(where: Path, record: ArrayRecord) -> None:
    """Raises CorruptArtifact for a `zarr.json` that contradicts the manifest or is not as our own writer writes it.

    Compares JSON texts: 1, 1.0 and True are equal in Python, but not to zarr.
    """
    try:
        found = parse_json(read_plain_file(where / DESCRIPTION))
        found = {name: value for name, value in found.items() if name not in OPTIONAL or value != OPTIONAL[name]}
        same = json.dumps(found, sort_keys=True) == json.dumps(_description(record, found), sort_keys=True)
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise CorruptArtifact(f"{where / DESCRIPTION}: does not describe an array ({error})") from error
    if not same:
        raise CorruptArtifact(f"{where / DESCRIPTION}: not what we would write for this array")


def _description(record: ArrayRecord, found: Any) -> dict[str, Any]:
    """What our writer would say of this array, except for the compression level found, which only has to be valid."""
    level = found["codecs"][1]["configuration"]["level"]
    if type(level) is not int or not 1 <= level <= HARDEST:
        raise ValueError(f"compression level {level!r}; expected 1 to {HARDEST}")
    little = {"name": "bytes", "configuration": {"endian": "little"}}
    in_bytes = {"name": "bytes"} if int(record.dtype[2:]) == 1 and found["codecs"][0] != little else little
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(record.shape),
        "data_type": _name_of_type(record.dtype),
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(record.chunks)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": EMPTY[record.dtype[1]],
        "codecs": [in_bytes, {"name": "zstd", "configuration": {"level": level, "checksum": True}}],
        "attributes": {},
    }


def _name_of_type(code: str) -> str:
    kind = TYPE.fullmatch(code)
    assert kind
    return NAMES[kind[1]] if kind[1] == "b" else f"{NAMES[kind[1]]}{8 * int(kind[2])}"


def _check_chunk(path: Path, expected: int) -> None:
    """Walks through a Zstandard frame (RFC 8878, 3.1.1): it must state `expected` bytes, and be alone in its file.

    The decoder would allocate whatever a frame states, and go on with frames behind it. Raises CorruptArtifact.
    """
    try:
        with path.open("rb") as file:
            head = file.read(14)
            stated, start = _frame(head)
            if stated != expected or _end_of_frame(file, start) != os.fstat(file.fileno()).st_size:
                raise CorruptArtifact(f"{path}: does not decompress to the {expected} bytes of a chunk")
    except OSError as error:
        raise CorruptArtifact(f"{path}: missing") from error


def _frame(head: bytes) -> tuple[int | None, int]:
    """The content size in the header of a frame, and the offset of its first block; (None, 0) if it is not ours."""
    if head[:4] != ZSTANDARD or len(head) < 6:
        return None, 0
    flags = head[4]
    start = 5 if flags & SINGLE_SEGMENT else 6
    length = SIZE_BYTES[flags >> 6] or (1 if flags & SINGLE_SEGMENT else 0)
    if not flags & CHECKSUM or flags & RESERVED_OR_DICTIONARY or not length:
        return None, 0
    return int.from_bytes(head[start : start + length], "little") + (256 if length == 2 else 0), start + length


def _end_of_frame(file: BinaryIO, position: int) -> int | None:
    """The offset at which the checksum after the last block ends; None if the file ends before a last block."""
    while True:
        file.seek(position)
        header = file.read(3)
        if len(header) < 3:
            return None
        block = int.from_bytes(header, "little")
        last, kind, size = block & 1, block >> 1 & 3, block >> 3
        position += 3 + (1 if kind == REPEATED_BYTE else size)
        if last:
            return position + CHECKSUM_BYTES
