"""Records of actions: what went in, what came out, and how it went."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.canonical import Json
from pipeline.store.checksummed import read_checksummed

RECORD = "record.json"
DIGEST = re.compile(r"[0-9a-f]{64}")
TOLD = {"started": str, "versions": dict, "machine": dict, "facts": dict, "private": bool}
"""What the provenance contains in every version, with its types; besides, `seconds`."""
LONGEST = 1e12
"""Seconds, thirty thousand years: no action takes longer. The times of any number of actions have a finite sum."""


@dataclass(frozen=True)
class Record:
    """An action that was done.

    The key is the hash of `parts`. `outputs` holds the digests of what came out, `provenance` everything else worth
    knowing: when, how long, with which versions, where, from which commit.
    """

    key: str
    parts: Mapping[str, Json]
    outputs: Mapping[str, str]
    provenance: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        """How long the action took, in seconds."""
        return float(self.provenance["seconds"])

    @property
    def accepted(self) -> tuple[Mapping[str, Any], ...]:
        """Each time that a person said a change did not matter: `from` which key, `when`, at which `commit`, and the
        `changes` in words. Empty for a result that the action itself made.
        """
        return tuple(self.provenance.get("accepted", ()))

    @property
    def name(self) -> str:
        """The stage's name in the workflow whose run did it; empty if unknown."""
        return str(self.provenance.get("name", ""))

    @property
    def workflow(self) -> str:
        """The workflow whose run did it; others may use the result. Empty if unknown."""
        return str(self.provenance.get("workflow", ""))

    @property
    def inputs(self) -> dict[str, list[str]]:
        """The digests of the artifacts that it took, by input."""
        return _groups(self.parts.get("inputs"))

    @property
    def taken(self) -> list[str]:
        """The digests of all artifacts that it took."""
        return [digest for digests in self.inputs.values() for digest in digests]

    @property
    def external(self) -> dict[str, list[str]]:
        """The digests of the files and folders outside the store that it took, by parameter."""
        return _groups(self.parts.get("external"))

    @property
    def private(self) -> bool:
        """Whether any output is private."""
        return bool(self.provenance.get("private"))

    @property
    def unrepeatable(self) -> bool:
        """Whether no run can make its outputs again; False in records of earlier versions, which do not say."""
        return self.provenance.get("unrepeatable") is True


def read_record(path: Path, key: str) -> Record | None:
    """The record of the action `key` in a file; None if it is missing, malformed or altered.

    The checksum alone is not trusted: who can write to a bucket can make a record that fits it, and its digests become
    paths.
    """
    content = read_checksummed(path) or {}
    parts, outputs, provenance = (content.get(name) for name in ("parts", "outputs", "provenance"))
    if content.get("key") != key or not isinstance(parts, dict) or not isinstance(outputs, dict):
        return None
    if not all(map(is_digest, outputs.values())) or not isinstance(provenance, dict) or not _is_told(provenance):
        return None
    return Record(key, parts, outputs, provenance)


def _groups(given: Json) -> dict[str, list[str]]:
    """Lists of digests, by the name that they were given under; anything else is left out."""
    groups = given.items() if isinstance(given, dict) else ()
    return {name: [str(digest) for digest in group] for name, group in groups if isinstance(group, list)}


def is_digest(found: object) -> bool:
    """Whether this can be the digest of an artifact or the key of an action.

    Files are named by them, and what is in a bucket may be anyone's.
    """
    return isinstance(found, str) and DIGEST.fullmatch(found) is not None


def is_time(found: object) -> bool:
    """Whether this can be how long an action took, in seconds: JSON may hold NaN, and integers beyond every float."""
    return isinstance(found, int | float) and abs(found) <= LONGEST


def _is_told(provenance: Mapping[str, Any]) -> bool:
    """Whether a provenance has everything that is read from it, in the right types."""
    return (
        all(isinstance(provenance.get(name), kind) for name, kind in TOLD.items())
        and is_time(provenance.get("seconds"))
        and isinstance(provenance.get("commit"), str | None)
        and _are_texts(provenance.get("from_accepted", []))
        and isinstance(accepted := provenance.get("accepted", []), list)
        and all(map(_is_acceptance, accepted))
    )


def _is_acceptance(note: object) -> bool:
    return isinstance(note, dict) and isinstance(note.get("when"), str) and _are_texts(note.get("changes"))


def _are_texts(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)


def first_makers(records: Iterable[Record]) -> dict[str, Record]:
    """The first of `records` that made each artifact, by digest; later ones made the same again, or imported it.

    So the inputs of an action were made before it, and following them back always comes to an end.
    """
    return {digest: record for record in reversed(_by_start(records)) for digest in record.outputs.values()}


def newest_makers(records: Iterable[Record]) -> dict[str, Record]:
    """The last of `records` that made each artifact, by digest."""
    return {digest: record for record in _by_start(records) for digest in record.outputs.values()}


def _by_start(records: Iterable[Record]) -> list[Record]:
    """Records by start time. An accepted result has the start time of the one it was made from, and comes after it."""
    return sorted(records, key=lambda record: (str(record.provenance.get("started", "")), len(record.accepted)))
