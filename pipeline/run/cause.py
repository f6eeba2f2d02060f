"""Causes of failures, in words: for a person, and for a key, where the same failure gives the same words every time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from pipeline.disk import IN_WORDS, words_of
from pipeline.errors import PipelineError
from pipeline.plain_text import without_controls
from pipeline.store.store import Store
from pipeline.workflow.graph import Node

LONGEST_FOREIGN = 500  # characters of a message that is not ours
LONGEST = 4000  # characters; generous, since the most useful part of a message, what to do, comes last
VARYING = (
    (re.compile(r"(?<![\w.])/(?:[^\s/:;,'\"]+/)+"), ""),  # folders; the name at the end of a path stays
    (re.compile(r"\b0x[0-9a-f]+\b", re.IGNORECASE), "0x…"),
    (re.compile(r"\b[0-9a-f]{16,}\b", re.IGNORECASE), "…"),  # digests and random names
    (re.compile(r"\b[0-9.]+ ?(?:ms|s|seconds?|min|minutes?|h|hours?)\b"), "some time"),
    (re.compile(r"\b[0-9.]+ ?[kMGT]?i?B free\b"), "some free"),
    (re.compile(r"\bafter [0-9.]+ ?[kMGT]?i?B were written\b"), "after some were written"),
    (re.compile(r"\b[0-9.]+ ?[kKMGT]?i?B(?= (?:is free|memory in use|is allocated|is reserved))"), "some"),
    (re.compile(r"\b(pid|process) \d+\b", re.IGNORECASE), r"\1 …"),
    (re.compile(r"(?<=\d:)\d{4,5}\b"), "…"),  # ports
)

MORE_MEMORY = (
    "If other stages or programs run at the same time: --workers 1, or stop them. Otherwise give the stage less to do "
    "(smaller pictures, fewer Gaussians), or run it on a machine with more memory."
)


def cause_of(error: BaseException, store: Path | str, written: int = 0) -> str:
    """One line for a person: our own messages as they are, disk errors in words, other errors with their type.

    A disk error says how much was `written`, in bytes; a lack of memory, what to do. It has no controls: it may quote
    names from a stranger's files.
    """
    if isinstance(error, OSError) and error.errno in IN_WORDS:
        return without_controls(words_of(error, store, written))
    lines = str(error).strip().splitlines() or [""]
    if isinstance(error, PipelineError):
        return without_controls(" ".join(line.strip() for line in lines))
    cause = without_controls(f"{type(error).__name__}: {lines[0]}"[:LONGEST_FOREIGN])
    return f"too little memory ({cause}). {MORE_MEMORY}" if _is_lack_of_memory(error) else cause


def _is_lack_of_memory(error: BaseException) -> bool:
    """Whether there was no memory left, of this machine or of a GPU; loads neither torch nor OpenCL to find out.

    Their errors for a GPU have own types, which are no MemoryError; torch's for this machine is a RuntimeError.
    """
    return (
        isinstance(error, MemoryError)
        or type(error).__name__ in ("OutOfMemoryError", "MemoryError")
        or (isinstance(error, RuntimeError) and "can't allocate memory" in str(error))
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
