"""Extracts the coded pictures from the boxes (ISO/IEC 14496-12) of an animated AVIF file."""

from __future__ import annotations

import struct
from collections.abc import Iterator

HEADERS = {b"stsd": 8, b"av01": 78}
"""Bytes between a box's header and its child boxes, if not 0."""

TEMPORAL_DELIMITER = b"\x12\x00"


def coded_pictures(file: bytes) -> tuple[bytes, list[bytes]]:
    """The codec configuration (`av1C`) and the AV1 data of each picture of an animated AVIF file, in order.

    Temporal delimiters are removed, since containers forbid them. Only for files of our own encoder: one track, all
    pictures in one chunk. Raises `ValueError` for others.
    """
    table = _inside(file, b"moov", b"trak", b"mdia", b"minf", b"stbl")
    configuration = _inside(table, b"stsd", b"av01", b"av1C")
    (chunks, offset) = struct.unpack_from(">4xII", _inside(table, b"stco"))
    uniform, count = struct.unpack_from(">4xII", _inside(table, b"stsz"))
    if chunks != 1 or uniform:
        raise ValueError(f"an animation in {chunks} chunks, of pictures of {uniform} bytes each")
    sizes = struct.unpack_from(f">{count}I", _inside(table, b"stsz"), 12)
    pictures = []
    for size in sizes:
        pictures.append(file[offset : offset + size].removeprefix(TEMPORAL_DELIMITER))
        offset += size
    return configuration, pictures


def _inside(data: bytes, *path: bytes) -> bytes:
    """The content of a nested box: at each level of `path`, the first box of that name."""
    for name in path:
        found = next((content for box, content in _boxes(data) if box == name), None)
        if found is None:
            raise ValueError(f"no {name.decode()} among the boxes {[box for box, _ in _boxes(data)]}")
        data = found[HEADERS.get(name, 0) :]
    return data


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    position = 0
    while position + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, position)
        if size < 8:
            raise ValueError(f"a box {name!r} of {size} bytes")
        yield name, data[position + 8 : position + size]
        position += size
