"""Headings of a table that span several columns."""

from __future__ import annotations

from collections.abc import Sequence


def first_columns(groups: Sequence[tuple[str, int]]) -> tuple[int, ...]:
    """The first column under each heading, given the headings and the number of columns that each spans."""
    spans = [span for _, span in groups]
    return tuple(sum(spans[:index]) for index in range(len(spans)))
