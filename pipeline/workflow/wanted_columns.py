"""Which columns of a table a workflow uses, found before the table is read, so that `Cover` can pass for `cover`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pipeline.workflow.located import Located
from pipeline.workflow.substitution import references

ITEM = "item."


def wanted_columns(stages: Mapping[str, Located], settings: Mapping[str, Located]) -> dict[str, tuple[str, ...]]:
    """For the text of each `foreach`, such as `${pairs}`, the columns that the stages with it use, in order.

    `settings` are those of `--set`; some replace parameters that the file states.
    """
    wanted: dict[str, dict[str, None]] = {}
    for stage, body in stages.items():
        rows = body.value.get("foreach") if isinstance(body.value, Mapping) else None
        if rows is not None and isinstance(rows.value, str):
            taken = [name for value in _values(stage, body, settings) for name in references(value)]
            columns = (name.removeprefix(ITEM) for name in taken if name.startswith(ITEM))
            wanted.setdefault(rows.value, {}).update(dict.fromkeys(columns))
    return {text: tuple(columns) for text, columns in wanted.items()}


def _values(stage: str, body: Located, settings: Mapping[str, Located]) -> Iterator[Located]:
    """Everything that is said about a stage, in the file or by a setting that replaces it."""
    for key, value in body.value.items() if isinstance(body.value, Mapping) else ():
        if key == "with" and isinstance(value.value, Mapping):
            yield from (each for name, each in value.value.items() if f"{stage}.{name}" not in settings)
        else:
            yield value
    yield from (value for name, value in settings.items() if name.startswith(f"{stage}."))
