"""Records: what an action was made of, what came out, and how it went."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.canonical import Json
from pipeline.sealed import read_sealed

RECORD = "record.json"
KEY = re.compile(r"[0-9a-f]{64}")  # of actions, and digests of artifacts


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
        given = self.parts.get("inputs")
        groups = given.items() if isinstance(given, dict) else ()
        return {name: [str(digest) for digest in group] for name, group in groups if isinstance(group, list)}

    @property
    def taken(self) -> list[str]:
        """The digests of all artifacts that it took."""
        return [digest for digests in self.inputs.values() for digest in digests]

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
    content = read_sealed(path)
    if not content or content["key"] != key or not _are_digests(content["outputs"]):
        return None
    return Record(content["key"], content["parts"], content["outputs"], content["provenance"])


def _are_digests(outputs: object) -> bool:
    digests = outputs.values() if isinstance(outputs, dict) else [outputs]
    return all(isinstance(digest, str) and KEY.fullmatch(digest) for digest in digests)


def newest_makers(records: Iterable[Record]) -> dict[str, Record]:
    """For each artifact the last of `records` that made it, by digest."""
    ordered = sorted(records, key=lambda record: str(record.provenance.get("started", "")))
    return {digest: record for record in ordered for digest in record.outputs.values()}
