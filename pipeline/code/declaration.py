"""What the stages of a package declare, known without importing them if possible.

A stage module imports torch, which takes seconds, and a run with nothing to do should take none. What a stage declares,
and how it completes given parameters, depends only on its code and on the files in the user's data folder. So both are
kept in the store's cache, in a file named after a fingerprint of these, and the module is imported only on a miss.
"""

from __future__ import annotations

import importlib
import json
import re
import typing
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pydantic
from pydantic.fields import FieldInfo

from pipeline.canonical import Json, digest_of, digest_of_file, plain
from pipeline.code.fingerprint import Code, SourceTree
from pipeline.code.source_cache import SourceCache
from pipeline.data_folder import data_files
from pipeline.errors import UserError, nearest
from pipeline.package_modules import modules_in
from pipeline.stage import ExternalMarker, Input, Output, Parameters, Stage
from pipeline.store.checksummed import read_checksummed, with_checksum, write_text_whole
from pipeline.store.store import Store

FORMAT = 8
DECLARATION = "declaration"
LITERAL = re.compile("'([^']*)'")
TEXT_WANTED = ("string_type", "path_type")  # pydantic's words
MOST_ANSWERS = 20_000
"""Cached for one stage; beyond that, answers that the present workflow does not ask for are dropped."""


@dataclass(frozen=True)
class Declaration:
    """A stage as its author declared it; `external` names the parameters that are paths outside the store."""

    uses: str
    inputs: Mapping[str, Input]
    outputs: Mapping[str, Output]
    version: int
    alone: bool
    resources: Mapping[str, float]
    selects_modules: bool
    external: tuple[str, ...]
    unread: Mapping[str, Mapping[str, Json]]


@dataclass(frozen=True)
class Completed:
    """Parameters with their defaults. `external` holds the external paths, `modules` what parameters select.

    `unrepeatable`: no run can make again what is made with them.
    """

    parameters: Mapping[str, Json]
    external: Mapping[str, tuple[str, ...]]
    modules: tuple[str, ...]
    unrepeatable: bool


@dataclass(frozen=True)
class Refusal:
    """One reason why parameters are refused; `path` leads to the value, and is empty if it is the whole.

    `text_wanted`: the value has to be text and is not.
    """

    path: tuple[str | int, ...]
    message: str
    missing: bool = False
    text_wanted: bool = False

    @property
    def name(self) -> str:
        """The path as its message spells it."""
        return ".".join(map(str, self.path))


class Catalogue:
    """The stages of `package`, whose code may also be in the packages `libraries`."""

    def __init__(self, package: str, libraries: tuple[str, ...], store: Store) -> None:
        top = package.partition(".")[0]
        self.package = package
        self._source_cache = SourceCache(store, top)
        self.sources = SourceTree((top, *libraries), self._source_cache.module)
        self._store = store
        self._stages: dict[str, Stage] = {}
        self._codes: dict[tuple[str, ...], Code] = {}
        self._answers: dict[str, dict[str, Any]] = {}
        self._new: set[str] = set()
        self._completed: dict[tuple[str, str], Completed] = {}

    def code(self, uses: str, modules: tuple[str, ...] = ()) -> Code:
        """The code behind a stage. Raises UserError if a module that its parameters select is missing or not Python."""
        roots = (f"{self.package}.{uses}", *modules)
        if roots not in self._codes:
            self._codes[roots] = self.sources.code(roots)
        return self._codes[roots]

    def names(self) -> list[str]:
        """The stages that a workflow can use: the modules directly in the package.

        Raises UserError if there is no such package.
        """
        package = self.sources.module(self.package)
        if package is None:
            raise UserError("no such package of stages", found=self.package)
        return modules_in(package.path.parent)

    def declaration(self, uses: str) -> Declaration:
        """What a stage declares. Raises UserError if there is no such stage, or its module does not define it."""
        if uses not in self.names():
            raise UserError(f"no stage {uses!r}; there are {', '.join(self.names())}{nearest(uses, self.names())}")
        cached = self._cached(uses, DECLARATION)
        if cached is None:
            cached = self._keep(uses, DECLARATION, _describe(self.stage(uses)))
        return Declaration(
            uses=uses,
            inputs={name: Input(**port) for name, port in cached["inputs"].items()},
            outputs={name: Output(**port) for name, port in cached["outputs"].items()},
            version=cached["version"],
            alone=cached["alone"],
            resources=cached["resources"],
            selects_modules=cached["selects_modules"],
            external=tuple(cached["external"]),
            unread=cached["unread"],
        )

    def complete(self, uses: str, arguments: Mapping[str, Json]) -> Completed | list[Refusal]:
        """The given parameters with their defaults, or every reason why they are refused.

        Raises UserError if the stage has to be imported and that fails.
        """
        question = json.dumps(arguments, sort_keys=True)
        if (uses, question) in self._completed:
            return self._completed[uses, question]
        cached = self._cached(uses, question)
        if cached is None or cached["code"] != self._digest(uses, cached["modules"]):
            completed = _complete(self.stage(uses), arguments)
            if isinstance(completed, list):
                return completed
            code = self._digest(uses, completed.modules)
            cached = self._keep(uses, question, {**asdict(completed), "code": code})
        external = {name: tuple(paths) for name, paths in cached["external"].items()}
        answer = Completed(cached["parameters"], external, tuple(cached["modules"]), cached["unrepeatable"])
        self._completed[uses, question] = answer
        return answer

    def _digest(self, uses: str, modules: Sequence[str]) -> str | None:
        """The digest of a stage's code with the modules that parameters select: these may affect their completion."""
        try:
            return self.code(uses, tuple(modules)).digest
        except UserError:
            return None

    def keep_in(self, store: Store) -> None:
        """Makes `remember` write to this store from now on."""
        self._store = self._source_cache.store = store

    def remember(self) -> None:
        """Writes what was learnt about stages and their code to the store, for the next run; ignores failed writes."""
        self._source_cache.remember()
        for code in self._codes.values():
            if not self._store.knows_code(code.digest):
                self._store.keep_code(code.digest, code.modules, self.sources.definitions(code))
        for uses in self._new:
            answers = self._answers[uses]
            if len(answers) > MOST_ANSWERS:
                asked = {DECLARATION, *(question for name, question in self._completed if name == uses)}
                answers = {question: answer for question, answer in answers.items() if question in asked}
            with suppress(OSError):  # a store may be read-only
                self._store.folder("cache", "declarations")
                write_text_whole(self._cache_file(uses), with_checksum(answers), self._store.temporary(), mode=0o600)
        self._new.clear()

    def stage(self, uses: str) -> Stage:
        """The stage itself, with its module imported. Raises UserError if that fails."""
        if uses not in self._stages:
            self._stages[uses] = import_stage(self.package, uses)
        return self._stages[uses]

    def _cached(self, uses: str, question: str) -> Any:
        if uses not in self._answers:
            self._answers[uses] = _read_answers(self._cache_file(uses))
        return self._answers[uses].get(question)

    def _keep(self, uses: str, question: str, answer: dict[str, Any]) -> dict[str, Any]:
        self._answers[uses][question] = answer
        self._new.add(uses)
        return answer

    def _cache_file(self, uses: str) -> Path:
        engine = [FORMAT, pydantic.VERSION, *data_files()]
        module = self.sources.module(f"{self.package}.{uses}")
        text = digest_of_file(module.path) if module else ""  # it holds more than the code's digest
        name = digest_of([engine, self.package, uses, self.code(uses).digest, text], f"stage {uses}")
        return self._store.root / "cache" / "declarations" / f"{name}.json"


def _read_answers(file: Path) -> dict[str, Any]:
    return read_checksummed(file) or {}


def import_stage(package: str, uses: str) -> Stage:
    """The stage `uses` in the module `package.uses`. Raises UserError if the module fails, or defines no such stage."""
    name = f"{package}.{uses}"
    try:
        module = importlib.import_module(name)
    except Exception as error:
        raise UserError(f"module {name} cannot be imported: {type(error).__name__}: {error}") from error
    declared = getattr(module, uses, None)
    if not isinstance(declared, Stage):
        raise UserError(f"module {name} defines no stage {uses!r}; expected a function decorated with @stage")
    return declared


def validate(declared: Stage, arguments: Mapping[str, Json]) -> Parameters:
    """The parameters of a stage, from JSON: a list may stand for a tuple, and text for a path.

    Null stands for the stage's own default, if there is one and null is not itself a value of the parameter. Raises
    pydantic.ValidationError for values that the stage refuses.
    """
    fields = declared.parameters.model_fields
    stated = {name: value for name, value in arguments.items() if value is not None or not _is_own(fields.get(name))}
    return declared.parameters.model_validate_json(json.dumps(stated))


def _is_own(field: FieldInfo | None) -> bool:
    """Whether null resets a parameter to the stage's own default."""
    return field is not None and not field.is_required() and type(None) not in typing.get_args(field.annotation)


def check_completed(declared: Stage, parameters: Parameters, planned: Mapping[str, Json]) -> None:
    """Raises UserError if parameters are completed differently here than where the run was planned."""
    here = _values(declared, parameters)
    for name, value in planned.items():
        if here.get(name) != value:
            raise UserError(
                f"the parameter {name!r} has a different value on this machine than where the run was planned",
                found=json.dumps(here.get(name)),
                expected=json.dumps(value),
                remedy="Install the same software on both machines, and run again.",
            )


def is_unrepeatable(declared: Stage, parameters: Parameters) -> bool:
    """Whether no run can make again what a stage makes with these parameters."""
    return bool(declared.unrepeatable(parameters)) if declared.unrepeatable else False


def external_fields(model: type[Parameters]) -> tuple[str, ...]:
    """Names of the parameters whose type is, or contains, `ExternalPath`."""
    hints = typing.get_type_hints(model, include_extras=True)
    return tuple(name for name in model.model_fields if _holds_marker(hints[name]))


def external_paths(parameters: Parameters) -> dict[str, tuple[str, ...]]:
    """The external paths that each parameter holds, given or by default; none for null."""
    external = {}
    for name in external_fields(type(parameters)):
        value = getattr(parameters, name)
        paths = value if isinstance(value, list | tuple) else () if value is None else (value,)
        external[name] = tuple(str(path) for path in paths)
    return external


def _holds_marker(annotation: Any) -> bool:
    if any(isinstance(extra, ExternalMarker) for extra in getattr(annotation, "__metadata__", ())):
        return True
    return any(_holds_marker(argument) for argument in typing.get_args(annotation))


def _describe(declared: Stage) -> dict[str, Any]:
    return {
        "inputs": {name: asdict(port) for name, port in declared.inputs.items()},
        "outputs": {name: asdict(port) for name, port in declared.outputs.items()},
        "version": declared.version,
        "alone": declared.alone,
        "resources": dict(declared.resources),
        "selects_modules": declared.modules is not None,
        "external": external_fields(declared.parameters),
        "unread": {name: dict(values) for name, values in declared.unread.items()},
    }


def _complete(declared: Stage, arguments: Mapping[str, Json]) -> Completed | list[Refusal]:
    try:
        parameters = validate(declared, arguments)
    except pydantic.ValidationError as error:
        return [_refusal(declared.parameters, detail) for detail in error.errors(include_url=False)]
    except UserError as error:  # from what the stage consults to complete them
        return [Refusal((), str(error))]
    try:
        kept = _values(declared, parameters)
        selected = tuple(declared.modules(parameters)) if declared.modules else ()
        unrepeatable = is_unrepeatable(declared, parameters)
    except Exception as error:
        return [Refusal((), f"{type(error).__name__}: {error}")]
    return Completed(kept, external_paths(parameters), selected, unrepeatable)


def _values(declared: Stage, parameters: Parameters) -> dict[str, Json]:
    """The values of all parameters that are not external paths."""
    values = parameters.model_dump(exclude=set(external_fields(declared.parameters)))
    return {name: plain(value, f"parameter {name!r}") for name, value in values.items()}


def _refusal(model: type[Parameters], detail: Any) -> Refusal:
    path = tuple(detail["loc"])
    name = ".".join(str(step) for step in path)
    if detail["type"] == "extra_forbidden":
        allowed = list(model.model_fields) if len(path) == 1 else []
        listed = f"; allowed: {', '.join(allowed) or 'none'}" if len(path) == 1 else ""
        return Refusal(path, f"unknown parameter {name!r}{listed}{nearest(name, allowed)}")
    if detail["type"] == "missing":
        field = model.model_fields.get(name)
        about = f" ({(field.description or '').rstrip('.')})" if field else ""
        return Refusal(path, f"parameter {name!r} is missing{about}", missing=True)
    message = detail["msg"].removeprefix("Value error, ").removeprefix("Input ").removesuffix(".")
    if not path:
        return Refusal(path, message)
    found = json.dumps(detail["input"], default=str)
    shown = found if len(found) < 80 else found[:77] + "..."
    text_wanted = detail["type"] in TEXT_WANTED
    return Refusal(path, f"parameter {name!r} {message}; found {shown}{_alike(detail)}", text_wanted=text_wanted)


def _alike(detail: Any) -> str:
    """A hint at the allowed word that was probably meant; empty if there is none."""
    if detail["type"] == "literal_error" and isinstance(detail["input"], str):
        return nearest(detail["input"], LITERAL.findall(detail["ctx"]["expected"]))
    return ""
