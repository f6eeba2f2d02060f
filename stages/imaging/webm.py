"""A deterministic WebM writer for coded AV1 pictures: https://www.webmproject.org/docs/container."""

from __future__ import annotations

import struct
from collections.abc import Sequence

CODED = "V_AV1"
FULL_RANGE, SRGB, BT601, BT709 = 2, 13, 6, 1
VIDEO_TRACK = 1
KEY_PICTURE = 0x80
LONGEST_CLUSTER = 30_000  # milliseconds: times within a cluster are signed 16-bit numbers

WRITER = "webm"
"""The muxer's name, which files must state; it does not reveal what made the pictures."""

MILLISECOND = 1_000_000  # nanoseconds, in which files state their unit of time


def write_webm(
    configuration: bytes, pictures: Sequence[bytes], size: tuple[int, int], pictures_a_second: float
) -> bytes:
    """A file with one video track; `configuration` is the codec's (`av1C`), `size` is width and height.

    Colours are full-range BT.601, as Pillow codes them. Only the first picture is marked as a key frame.
    """
    times = [round(1000 * number / pictures_a_second) for number in range(len(pictures) + 1)]
    information = _element(
        0x1549A966,
        _number(0x2AD7B1, MILLISECOND),
        _element(0x4489, struct.pack(">d", times[-1])),  # duration
        _text(0x4D80, WRITER),  # the muxer
        _text(0x5741, WRITER),  # the application
    )
    track = _element(0x1654AE6B, _track(configuration, size, pictures_a_second))
    clusters = _clusters(pictures, times)
    cues = _cues(len(information) + len(track))
    return _header() + _element(0x18538067, information, track, *clusters, cues)


def _header() -> bytes:
    return _element(
        0x1A45DFA3,
        _number(0x4286, 1),  # EBML version, and the lowest that a reader must support
        _number(0x42F7, 1),
        _number(0x42F2, 4),  # maximum lengths of identifiers and of sizes, in bytes
        _number(0x42F3, 8),
        _text(0x4282, "webm"),
        _number(0x4287, 4),  # WebM version, and the lowest that a reader must support
        _number(0x4285, 2),
    )


def _track(configuration: bytes, size: tuple[int, int], pictures_a_second: float) -> bytes:
    colour = _element(
        0x55B0, _number(0x55B1, BT601), _number(0x55B9, FULL_RANGE), _number(0x55BA, SRGB), _number(0x55BB, BT709)
    )
    video = _element(0xE0, _number(0xB0, size[0]), _number(0xBA, size[1]), colour)
    return _element(
        0xAE,
        _number(0xD7, 1),  # track number and unique identifier
        _number(0x73C5, 1),
        _number(0x83, VIDEO_TRACK),
        _number(0x9C, 0),  # no lacing
        _number(0x23E383, round(1000 * MILLISECOND / pictures_a_second)),
        _text(0x86, CODED),
        _element(0x63A2, configuration),
        video,
    )


def _clusters(pictures: Sequence[bytes], times: Sequence[int]) -> list[bytes]:
    """The pictures, in clusters of at most `LONGEST_CLUSTER` milliseconds."""
    clusters: list[bytes] = []
    blocks: list[bytes] = []
    start = 0
    for number, picture in enumerate(pictures):
        if blocks and times[number] - start > LONGEST_CLUSTER:
            clusters.append(_element(0x1F43B675, _number(0xE7, start), *blocks))
            blocks, start = [], times[number]
        flags = KEY_PICTURE if number == 0 else 0
        blocks.append(_element(0xA3, struct.pack(">BhB", 0x81, times[number] - start, flags), picture))
    return [*clusters, _element(0x1F43B675, _number(0xE7, start), *blocks)]


def _cues(position: int) -> bytes:
    """An index with one entry: the first cluster, `position` bytes after the start of the segment's content."""
    place = _element(0xB7, _number(0xF7, 1), _number(0xF1, position))
    return _element(0x1C53BB6B, _element(0xBB, _number(0xB3, 0), place))


def _element(identifier: int, *contents: bytes) -> bytes:
    """An EBML element: identifier, size in eight bytes, contents."""
    name = identifier.to_bytes((identifier.bit_length() + 7) // 8, "big")
    return name + (1 << 56 | sum(map(len, contents))).to_bytes(8, "big") + b"".join(contents)


def _number(identifier: int, value: int) -> bytes:
    return _element(identifier, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def _text(identifier: int, value: str) -> bytes:
    return _element(identifier, value.encode("ascii"))
