"""Files of an exported bundle that are no longer what was exported.

An export has a manifest with the hash of every file. It proves nothing, since whoever alters a file can alter it, too;
but it tells a bad copy, or files of two containers in one folder, which otherwise show the cover in wrong colours.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.artifact import Artifact, load
from pipeline.errors import CorruptArtifact


def altered_files(place: Path) -> list[str]:
    """The names of files in the folder `place` that are missing or altered according to its manifest, sorted.

    Empty for a single file, and without a manifest that can be read.
    """
    try:
        exported = load(place)
    except CorruptArtifact:
        return []
    return [name for name in exported.files if not _is_whole(exported, name)]


def _is_whole(exported: Artifact, name: str) -> bool:
    try:
        exported.file(name)
    except CorruptArtifact:
        return False
    return True
