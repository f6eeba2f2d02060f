"""With which earlier result a stage's is compared: one that asked for the same, or else the last.

Between two runs with the same settings others may have come, of another pair or with another λ. What those made asked
for something else, and does not say whether anything but code changed since.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from typing import Any

from pipeline.errors import RemoteError
from pipeline.graph import Node
from pipeline.history import StageResult
from pipeline.keys import asks_the_same
from pipeline.record import Record
from pipeline.store import Store

LOOKED_BACK = 20
"""Different results of a stage."""


class Kindred:
    """The earlier results of the stages of one workflow, read when they are first asked for."""

    def __init__(self, workflow: str, store: Store) -> None:
        self._workflow = workflow
        self._store = store

    def before(self, node: Node, key: str | None, parts: Mapping[str, Any], last: StageResult | None) -> Record | None:
        """The record of the newest result that asked for the same as these parts, by other code, and is whole.

        Where there is none that of `last`, whole or not; None without any. Of a stage whose results no run can make
        again all are looked at that the store has, of whatever workflow. Raises RemoteError where a bucket does not
        answer.
        """
        newest = self._store.record(str(last.key)) if last is not None else None
        if key is None or (newest is not None and (newest.key == key or asks_the_same(newest.parts, parts))):
            return newest
        alike = (record for record in self._earlier(node, key) if asks_the_same(record.parts, parts))
        return next((record for record in alike if self._store.find(record.key)), newest)

    def _earlier(self, node: Node, key: str) -> Iterator[Record]:
        for other in self._made.get(node.name, ())[:LOOKED_BACK]:
            record = self._store.record(other) if other != key else None
            if record is not None:
                yield record
        if node.unrepeatable:
            yield from (record for record in self._irreplaceable if record.key != key)

    @cached_property
    def _made(self) -> Mapping[str, list[str]]:
        with suppress(RemoteError, OSError):  # a bucket that cannot be reached just now costs an explanation
            return self._store.history.made(self._workflow)
        return {}

    @cached_property
    def _irreplaceable(self) -> list[Record]:
        """The newest first."""
        found = [record for record in self._store.records() if record.unrepeatable]
        return sorted(found, key=lambda record: str(record.provenance.get("started", "")), reverse=True)
