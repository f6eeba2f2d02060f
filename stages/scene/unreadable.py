"""Which pictures of a folder of any pictures cannot be read: a capture has them not, and says so.

A file of its own: what a capture is otherwise stays as it is, and with it all that is made of captures.
"""

from __future__ import annotations

from collections.abc import Iterable

from pipeline.artifact import Artifact, ArtifactWriter
from stages.scene.attributes import strings

UNREADABLE = "unreadable"


def write_unreadable_names(writer: ArtifactWriter, names: Iterable[str]) -> None:
    """Say in a `capture` artifact which pictures it lacks because they cannot be read; nothing where there are none."""
    if listed := list(names):
        writer.attributes[UNREADABLE] = [*listed]


def unreadable_names(capture: Artifact) -> tuple[str, ...]:
    """Their names, in the order written; empty where all could be read."""
    return tuple(strings(capture, UNREADABLE)) if UNREADABLE in capture.attributes else ()
