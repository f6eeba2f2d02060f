"""Records in a capture which pictures of a folder could not be read, and are therefore not in it.

A module of its own, so that captures, and all that is made from them, need not be made again.
"""

from __future__ import annotations

from collections.abc import Iterable

from pipeline.artifact import Artifact, ArtifactWriter
from stages.scene.attributes import strings

UNREADABLE = "unreadable"


def write_unreadable_names(writer: ArtifactWriter, names: Iterable[str]) -> None:
    """State in a `capture` artifact which pictures it lacks because they cannot be read; nothing if there are none."""
    if listed := list(names):
        writer.attributes[UNREADABLE] = [*listed]


def unreadable_names(capture: Artifact) -> tuple[str, ...]:
    """Names of the pictures that could not be read, in the order written; empty if all could."""
    return tuple(strings(capture, UNREADABLE)) if UNREADABLE in capture.attributes else ()
