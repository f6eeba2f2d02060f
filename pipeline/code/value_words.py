"""The values that a parameter can have, in words, from its type and its constraints."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pipeline.module_names import ModuleIn

NUMBERS = {int: "integer", float: "number"}
OTHERS = {bool: "true | false", str: "text", Path: "path", type(None): "null"}
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "multiple_of": "a multiple of"}


def value_words(annotation: Any, constraints: Iterable[Any] = ()) -> str:
    """The values of a type, where `constraints` are what pydantic knows of it besides.

    >>> from pydantic import Field
    >>> value_words(int, Field(ge=1).metadata), value_words(Literal["auto", "given"] | None)
    ('integer ≥ 1', 'auto | given, or null')
    >>> value_words(tuple[Annotated[float, Field(gt=0, le=1)], ...])
    'list of: number > 0 and ≤ 1'
    """
    constraints = list(constraints)
    for constraint in constraints:
        if isinstance(constraint, ModuleIn):
            return " | ".join(constraint.names())
    arguments = typing.get_args(annotation)
    origin = typing.get_origin(annotation)
    if origin is Annotated:
        return value_words(arguments[0], _constraints_in(annotation.__metadata__))
    if origin is Literal:
        return " | ".join(map(str, arguments))
    if origin in (Union, types.UnionType):
        return _either([value_words(each, constraints) for each in arguments])
    if origin in (tuple, list):
        items = [value_words(each) for each in arguments if each is not Ellipsis]
        return f"list of: {items[0]}" if origin is list or Ellipsis in arguments else f"[{', '.join(items)}]"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"{{{', '.join(_field(name, field) for name, field in annotation.model_fields.items())}}}"
    if origin in (dict, Mapping):
        return "mapping"
    return f"{NUMBERS[annotation]}{_bounds(constraints)}" if annotation in NUMBERS else OTHERS.get(annotation, "any")


def _field(name: str, field: FieldInfo) -> str:
    """A field of a mapping: its name, and its value if it can have one alone, which tells it from other mappings."""
    only = typing.get_args(field.annotation) if typing.get_origin(field.annotation) is Literal else ()
    return f"{name}: {only[0]}" if len(only) == 1 else name


def _constraints_in(metadata: Iterable[Any]) -> list[Any]:
    """Constraints as `Annotated` holds them: as they are, or inside a `Field`."""
    return [each for one in metadata for each in (one.metadata if isinstance(one, FieldInfo) else [one])]


def _either(words: list[str]) -> str:
    """Alternatives in words, `null` last; those that are lists of words themselves are set off by a comma."""
    words = sorted(words, key=lambda each: each == "null")
    between = ", or " if any(" | " in each for each in words) else " or "
    return between.join(words)


def _bounds(constraints: Iterable[Any]) -> str:
    found = [
        f"{sign} {getattr(constraint, bound):g}"
        for constraint in constraints
        for bound, sign in BOUNDS.items()
        if hasattr(constraint, bound)
    ]
    return f" {' and '.join(found)}" if found else ""
