"""Reading an artifact's attributes. Artifacts may come from strangers, so types are checked on reading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from pipeline.artifact import Artifact
from pipeline.errors import UserError


def strings(artifact: Artifact, name: str) -> tuple[str, ...]:
    """A list of strings. Raises `UserError` for anything else."""
    value = artifact.attributes.get(name)
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise _wrong(artifact, name, value, "a list of strings")
    return tuple(cast(list[str], value))


def string(artifact: Artifact, name: str) -> str:
    """One string. Raises `UserError` for anything else."""
    value = artifact.attributes.get(name)
    if not isinstance(value, str):
        raise _wrong(artifact, name, value, "a string")
    return value


def mapping(artifact: Artifact, name: str) -> dict[str, object]:
    """An object of JSON values. Raises `UserError` for anything else."""
    value = artifact.attributes.get(name)
    if not isinstance(value, Mapping):
        raise _wrong(artifact, name, value, "an object")
    return dict(value)


def mappings(artifact: Artifact, name: str) -> tuple[dict[str, object], ...]:
    """A list of objects. Raises `UserError` for anything else."""
    value = artifact.attributes.get(name)
    if not isinstance(value, list) or not all(isinstance(entry, Mapping) for entry in value):
        raise _wrong(artifact, name, value, "a list of objects")
    return tuple(dict(cast(Mapping[str, object], entry)) for entry in value)


def _wrong(artifact: Artifact, name: str, found: object, expected: str) -> UserError:
    return UserError(
        f"attribute {name!r} of a {artifact.kind} is not what it should be",
        where=str(artifact.path),
        found=repr(found)[:80],
        expected=expected,
        remedy="the artifact was not made by this version; make it again",
    )
