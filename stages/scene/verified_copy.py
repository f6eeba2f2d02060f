"""Artifacts that somebody kept or was given: copies from a store, which may be damaged or of another kind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.artifact import Artifact, load
from pipeline.errors import CorruptArtifact, UserError


def verified_copy(place: Path, kind: str, remedy: str) -> Artifact:
    """The artifact of this kind at `place`, after every byte was checked; no array is decompressed.

    Raises `UserError`, which ends with `remedy`, if there is none, or if it is broken or of another kind.
    """
    with damage_told(place, kind, remedy):
        copy = load(place)
        copy.verify()
    if copy.kind != kind:
        raise UserError(
            "this is not the expected kind of artifact", where=place, found=copy.kind, expected=kind, remedy=remedy
        )
    return copy


@contextmanager
def damage_told(place: Path, kind: str, remedy: str) -> Iterator[None]:
    """Raises `UserError` if what is read inside finds the artifact at `place` missing or damaged."""
    try:
        yield
    except CorruptArtifact as error:
        raise UserError(f"{kind} missing or damaged", where=place, found=error, remedy=remedy) from error
