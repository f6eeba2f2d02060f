"""Paths in a workflow that lead outside the store, made absolute."""

from __future__ import annotations

from pipeline.canonical import Json
from pipeline.external import from_home, resolved
from pipeline.located import Located


def absolute(value: Located) -> Json:
    """The value of an external path, or a list of them, made absolute; anything else as it is, for others to refuse.

    A shell leaves the ~ in `--set cover=~/photos` as it stands, and so does whoever writes a workflow.
    """
    if isinstance(value.value, tuple):
        return [absolute(item) for item in value.value]
    if isinstance(value.value, str):
        return str(resolved(value.base / from_home(value.value)))
    return value.plain
