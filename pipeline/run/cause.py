"""Causes of failures, worded so that they can be part of a key: the same failure gives the same words every time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from pipeline.store.store import Store
from pipeline.workflow.graph import Node

LONGEST = 4000  # characters; generous, since the most useful part of a message, what to do, comes last
VARYING = (
    (re.compile(r"(?<![\w.])/(?:[^\s/:;,'\"]+/)+"), ""),  # folders; the name at the end of a path stays
    (re.compile(r"\b0x[0-9a-f]+\b", re.IGNORECASE), "0x…"),
    (re.compile(r"\b[0-9a-f]{16,}\b", re.IGNORECASE), "…"),  # digests and random names
    (re.compile(r"\b[0-9.]+ ?(?:ms|s|seconds?|min|minutes?|h|hours?)\b"), "some time"),
    (re.compile(r"\b[0-9.]+ ?[kMGT]?i?B free\b"), "some free"),
    (re.compile(r"\bafter [0-9.]+ ?[kMGT]?i?B were written\b"), "after some were written"),
    (re.compile(r"\b(pid|process) \d+\b"), r"\1 …"),
    (re.compile(r"(?<=\d:)\d{4,5}\b"), "…"),  # ports
)


def lasting_cause(node: Node, cause: str, store: Store) -> str:
    """Why a stage failed, as recorded for the stages that go on without it."""
    return f"{node.entry}: {lasting_words(cause.replace(f'{store.root}/', ''), node.outside_paths)}"


def lasting_words(cause: str, folders: Iterable[str] = ()) -> str:
    """`cause` on one line, without anything that differs between runs or reveals where files are.

    Paths keep only their last name, and those under one of `folders` what follows from the folder's name on. Durations,
    digests, addresses, process numbers, ports and amounts of space are replaced.

    >>> lasting_words("/photos/fox/7.jpg: found 10 bytes after 3.2 s at 0x7f3a")
    '7.jpg: found 10 bytes after some time at 0x…'
    >>> lasting_words("tls://127.0.0.1:38059 cannot do the work; found 41.0 kB free, process 4711")
    'tls://127.0.0.1:… cannot do the work; found some free, process …'
    >>> lasting_words("/my photos/fox/a/7.jpg: not a picture", ["/my photos/fox"])
    'fox/a/7.jpg: not a picture'
    """
    words = " ".join(cause.split())
    for folder in sorted(folders, key=len, reverse=True):
        words = words.replace(folder, Path(folder).name) if len(folder) > 1 else words
    for pattern, instead in VARYING:
        words = pattern.sub(instead, words)
    return words if len(words) <= LONGEST else f"{words[: LONGEST - 1]}…"
