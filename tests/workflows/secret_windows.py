"""Searches files for pieces of a secret: every window of 16 consecutive bytes of it, raw and as base64.

A window with few different bytes is not specific to the secret: zeros, ones and other padding are in every file. Nor is
what describes an artifact, which is why `pieces_of` leaves out `manifest.json` and `zarr.json`.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from pipeline.artifact import Artifact, load

WINDOW = 16
"""Bytes. In base64, 16 characters stand for 12 bytes, and every 16 bytes of the secret determine at least 20."""

LEAST_DIFFERENT = 8
"""Minimum number of different bytes in a window that counts: of random windows, one in 10^12 has fewer."""

DESCRIBING = ("manifest.json", "zarr.json")


class SecretWindows:
    """All windows of a secret's pieces, to be looked for in files."""

    def __init__(self, pieces: Iterable[bytes]):
        hashed = [_hashes(form)[_tell_something(form)] for piece in pieces for form in (piece, *encoded(piece))]
        self.hashes = np.unique(np.concatenate(hashed)) if hashed else np.empty(0, np.uint64)

    def first_in(self, data: bytes) -> int | None:
        """Position of the first window in `data`, or in its text without line breaks; None if there is none."""
        for form in (data, *_as_one_line(data)):
            found = np.flatnonzero(self._known(_hashes(form)))
            if len(found):
                return int(found[0])
        return None

    def _known(self, hashes: np.ndarray) -> np.ndarray:
        if not len(self.hashes):
            return np.zeros(len(hashes), bool)
        places = np.searchsorted(self.hashes, hashes).clip(max=len(self.hashes) - 1)
        return self.hashes[places] == hashes


def encoded(piece: bytes) -> Iterator[bytes]:
    """The base64 of a piece at each offset within a group of three bytes: the characters that depend on it alone."""
    for before in range(3):
        text = base64.b64encode(bytes(before) + piece).rstrip(b"=")
        last = len(text) - 1 if (before + len(piece)) % 3 else len(text)
        yield text[(0, 2, 3)[before] : last]


def pieces_of(artifact: Artifact) -> Iterator[bytes]:
    """The contents of an artifact: its arrays as bytes, and its files as stored, without those that describe it."""
    for name in artifact.names:
        yield artifact.read(name).tobytes()
    yield from (data for path, data in files_in(artifact.path) if path.name not in DESCRIBING)


def everything_in(artifact: Artifact) -> Iterator[tuple[str, bytes]]:
    """All that anyone with the artifact can read: every array and every file, with its name."""
    for name in artifact.names:
        yield f"{artifact.path}: {name}", artifact.read(name).tobytes()
    for path, data in files_in(artifact.path):
        yield str(path), data


def files_in(folder: Path) -> Iterator[tuple[Path, bytes]]:
    """Every regular file under a folder, with its contents."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink():
            yield path, path.read_bytes()


def open_to_others(store: Path) -> Iterator[tuple[str, bytes]]:
    """Everything in a store but private artifacts: all other artifacts, the records of what ran, and all logs.

    This includes private logs: they should hold no key, even if someone keeps them apart from the artifacts.
    """
    for folder in sorted((store / "objects").iterdir()):
        artifact = load(folder)
        if not artifact.private:
            yield from everything_in(artifact)
    for path, data in files_in(store):
        if not path.is_relative_to(store / "objects"):
            yield str(path), data


def _as_one_line(data: bytes) -> Iterator[bytes]:
    """A text as standard base64 would have it: without line breaks, and with the alphabet for URLs translated."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return
    yield data.translate(bytes.maketrans(b"-_", b"+/"), delete=b"\r\n \t\\")


def _hashes(data: bytes) -> np.ndarray:
    """A hash of the window at each place, mixed from its two halves. Empty for fewer bytes than a window."""
    if len(data) < WINDOW:
        return np.empty(0, np.uint64)
    values = np.frombuffer(data, np.uint8)
    words = np.zeros(len(values) - 7, np.uint64)
    for byte in range(8):
        words |= values[byte : byte + len(words)].astype(np.uint64) << np.uint64(8 * byte)
    first, second = words[:-8], words[8:]
    return (first * np.uint64(0x9E3779B97F4A7C15)) ^ (second * np.uint64(0xC2B2AE3D27D4EB4F))


def _tell_something(data: bytes) -> np.ndarray:
    """Whether the window at each place has enough different bytes."""
    if len(data) < WINDOW:
        return np.empty(0, bool)
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), WINDOW), axis=1)
    return (np.diff(windows, axis=1) != 0).sum(axis=1) + 1 >= LEAST_DIFFERENT
