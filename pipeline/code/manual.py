"""What a stage says of itself: what it is for, what it takes and makes, and its parameters with their defaults."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from pipeline.canonical import Json
from pipeline.code.declaration import import_stage
from pipeline.code.value_words import value_words
from pipeline.errors import UserError, nearest
from pipeline.package_modules import folders_of, modules_in
from pipeline.stage import Input, Output


@dataclass(frozen=True)
class ParameterManual:
    """A parameter: the values that it can have, in words, and its default; `required` if it has none."""

    values: str
    required: bool
    default: Json
    description: str


@dataclass(frozen=True)
class StageManual:
    """A stage: what it is for, on one line, whatever else its author says, and what a workflow can give it."""

    name: str
    summary: str
    text: str
    inputs: Mapping[str, Input]
    outputs: Mapping[str, Output]
    parameters: Mapping[str, ParameterManual]

    def as_json(self) -> dict[str, Json]:
        """Everything, as plain JSON."""
        return {"event": "stage_manual", **asdict(self)}


def summaries(package: str) -> dict[str, str]:
    """What each stage of a package is for, by name, on one line: read from the sources, without importing a stage.

    Raises UserError if there is no such package.
    """
    return {name: _split(name, _docstring(file))[0] for name, file in _files(package).items()}


def manual(package: str, name: str) -> StageManual:
    """The manual of one stage, whose module is imported. Raises UserError if there is none, or its import fails."""
    names = list(_files(package))
    if name not in names:
        raise UserError(f"no stage {name!r}; there are {', '.join(names)}{nearest(name, names)}")
    declared = import_stage(package, name)
    summary, text = _split(name, inspect.getdoc(sys.modules[f"{package}.{name}"]) or "")
    fields = declared.parameters.model_fields
    return StageManual(
        name, summary, text, declared.inputs, declared.outputs, {each: _parameter(fields[each]) for each in fields}
    )


def _parameter(field: FieldInfo) -> ParameterManual:
    required = field.is_required()
    default = None if required else to_jsonable_python(field.get_default(call_default_factory=True))
    return ParameterManual(value_words(field.annotation, field.metadata), required, default, field.description or "")


def _files(package: str) -> dict[str, Path]:
    """The modules of a package by name. Raises UserError if there is no such package."""
    try:
        folders = folders_of(package)
    except ModuleNotFoundError:
        folders = ()
    if not folders:
        raise UserError("no such package of stages", found=package)
    return {name: folder / f"{name}.py" for folder in folders for name in modules_in(folder)}


def _docstring(file: Path) -> str:
    """A module's docstring; empty if it has none, or is not Python."""
    try:
        return ast.get_docstring(ast.parse(file.read_bytes())) or ""
    except (SyntaxError, ValueError):
        return ""


def _split(name: str, docstring: str) -> tuple[str, str]:
    """The first paragraph as one line, without the stage's name in front, and the rest."""
    first, _, rest = docstring.partition("\n\n")
    return " ".join(first.removeprefix(f"`{name}`: ").split()), rest.strip()
