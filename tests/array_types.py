"""With `CHECK_ARRAYS=1`, arrays are checked, while tests run, against what functions state of their shapes and types.

Only arrays: other types are mypy's, and fakes of tests stand in for them. A dimension with a name has one size within a
call. Type checkers that check everything would also refuse those fakes.
"""

from __future__ import annotations

import functools
import inspect
import os
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, Union

from jaxtyping import AbstractArray

CONTAINERS = (Union, types.UnionType, tuple, list, dict, Mapping)


def arrays_are_checked() -> bool:
    """Whether this run of the tests checks them, by jaxtyping's import hook."""
    return os.environ.get("CHECK_ARRAYS", "0") != "0"


def arrays_checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which then raises TypeError for arrays, given or returned, that are not as its annotations say."""
    signature = inspect.signature(function)
    stated = {name: _annotation(each) for name, each in signature.parameters.items() if _of_arrays(each.annotation)}
    returned = signature.return_annotation if _of_arrays(signature.return_annotation) else Any
    if not stated and returned is Any:
        return function

    @functools.wraps(function)
    def called(*arguments: Any, **named: Any) -> Any:
        given = signature.bind(*arguments, **named).arguments
        for name, annotation in stated.items():
            if name in given and not _fits(given[name], annotation):
                raise TypeError(name)
        value = function(*arguments, **named)
        if not _fits(value, returned):
            raise TypeError("what is returned")
        return value

    return called


def _annotation(parameter: inspect.Parameter) -> Any:
    """What a parameter holds: of `*arguments` a tuple, of `**named` a dictionary."""
    match parameter.kind:
        case inspect.Parameter.VAR_POSITIONAL:
            return tuple[parameter.annotation, ...]
        case inspect.Parameter.VAR_KEYWORD:
            return dict[str, parameter.annotation]
    return parameter.annotation


def _is_array(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, AbstractArray)


def _of_arrays(annotation: Any) -> bool:
    """Whether an annotation is an array's, or a union's or a container's with arrays among its parts."""
    parts = typing.get_args(annotation) if typing.get_origin(annotation) in CONTAINERS else ()
    return _is_array(annotation) or any(map(_of_arrays, parts))


def _fits(value: Any, annotation: Any) -> bool:
    if _is_array(annotation):
        return isinstance(value, annotation)
    if annotation is type(None):
        return value is None
    if not _of_arrays(annotation):
        return True
    kind, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if kind in (Union, types.UnionType):
        return any(_fits(value, part) for part in parts)
    if kind in (dict, Mapping):
        return all(_fits(each, parts[1]) for each in value.values())
    if kind is tuple and Ellipsis not in parts:
        return len(value) == len(parts) and all(map(_fits, value, parts))
    return all(_fits(each, parts[0]) for each in value)
