"""Which earlier result a stage is compared with: one that asked for the same, or else the last.

Between two runs with the same settings there may have been others, of another pair or with another λ. Their results
asked for something else, and do not show whether anything but code has changed since.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from typing import Any

from pipeline.errors import RemoteError
from pipeline.plan.keys import asks_the_same
from pipeline.store.history import StageResult
from pipeline.store.record import Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Node

LOOKED_BACK = 20
"""How many different results of a stage are examined."""


class Kindred:
    """The earlier results of the stages of one workflow, read when they are first needed."""

    def __init__(self, workflow: str, store: Store) -> None:
        self._workflow = workflow
        self._store = store

    def before(self, node: Node, key: str | None, parts: Mapping[str, Any], last: StageResult | None) -> Record | None:
        """The record with which to compare a node of these parts; None if there is none.

        If `last` asked for the same, or `key` is None, it is the record of `last`; otherwise that of the newest whole
        result that asked for the same; if there is none, again that of `last`. If no run can make the stage's results
        again, all such results in the store are examined, of any workflow. Raises RemoteError if a bucket does not
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
        with suppress(RemoteError, OSError):  # a bucket that cannot be reached only costs an explanation
            return self._store.history.made(self._workflow)
        return {}

    @cached_property
    def _irreplaceable(self) -> list[Record]:
        """Records of results that no run can make again, newest first."""
        found = [record for record in self._store.records() if record.unrepeatable]
        return sorted(found, key=lambda record: str(record.provenance.get("started", "")), reverse=True)
