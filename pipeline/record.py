"""Records: what an action was made of, what came out, and how it went."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.canonical import Json
from pipeline.sealed import read_sealed

RECORD = "record.json"
KEY = re.compile(r"[0-9a-f]{64}")  # of actions, and digests of artifacts
TOLD = {"seconds": int | float, "started": str, "versions": dict, "machine": dict, "facts": dict, "private": bool}
"""What the provenance of every version tells, and of which type it is."""


@dataclass(frozen=True)
class Record:
    """An action that was done.

    `parts` is what its key is the hash of; `outputs` the digests of what came out; `provenance` all else worth
    knowing: when, how long, with which versions, where, from which commit.
    """

    key: str
    parts: Mapping[str, Json]
    outputs: Mapping[str, str]
    provenance: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        return float(self.provenance["seconds"])

    @property
    def accepted(self) -> tuple[Mapping[str, Any], ...]:
        """How often a person said that a change did not matter: `from` which key, `when`, at which `commit`, and
        the `changes` in words; empty for a result that the action itself made."""
        return tuple(self.provenance.get("accepted", ()))

    @property
    def name(self) -> str:
        """The stage's name in the workflow that had it done."""
        return str(self.provenance.get("name", ""))

    @property
    def workflow(self) -> str:
        """The workflow that had it done; others may use the result."""
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
        """Whether no run can make its outputs again; records of earlier versions do not tell."""
        return self.provenance.get("unrepeatable") is True


def read_record(path: Path, key: str) -> Record | None:
    """The record of the action `key` in a file; None where it is missing or not what was written.

    Whoever can write to a bucket can seal a record, too, and the digests in it become paths.
    """
    content = read_sealed(path) or {}
    parts, outputs, provenance = (content.get(name) for name in ("parts", "outputs", "provenance"))
    if content.get("key") != key or not isinstance(parts, dict) or not isinstance(outputs, dict):
        return None
    if not all(map(_is_digest, outputs.values())) or not isinstance(provenance, dict) or not _is_told(provenance):
        return None
    return Record(key, parts, outputs, provenance)


def _groups(given: Json) -> dict[str, list[str]]:
    """Digests by the name that they were given under; what is none is left out."""
    groups = given.items() if isinstance(given, dict) else ()
    return {name: [str(digest) for digest in group] for name, group in groups if isinstance(group, list)}


def _is_digest(value: object) -> bool:
    return isinstance(value, str) and KEY.fullmatch(value) is not None


def _is_told(provenance: Mapping[str, Any]) -> bool:
    """Whether it says what others read in it, and as we do."""
    return (
        all(isinstance(provenance.get(name), kind) for name, kind in TOLD.items())
        and abs(provenance["seconds"]) <= sys.float_info.max  # an integer may be larger than any number
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
    """For each artifact the first of `records` that made it, by digest: later ones made the same again, or imported it.

    So what an action took was made before it, and what is followed from it to what it took comes to an end.
    """
    return {digest: record for record in reversed(_by_start(records)) for digest in record.outputs.values()}


def newest_makers(records: Iterable[Record]) -> dict[str, Record]:
    """For each artifact the last of `records` that made it, by digest."""
    return {digest: record for record in _by_start(records) for digest in record.outputs.values()}


def _by_start(records: Iterable[Record]) -> list[Record]:
    """What was accepted began when that did which it was made from, and comes after it."""
    return sorted(records, key=lambda record: (str(record.provenance.get("started", "")), len(record.accepted)))
