"""What the shell offers when Tab is pressed: workflow files, stages, settings, artifacts and pins.

Completion runs in a process of its own while a person waits, so nothing here loads the engine. After any error it
offers nothing and prints nothing: the command itself reports what is wrong with a workflow.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import typer

from pipeline.code.declared_parameters import declared_parameters
from pipeline.package_modules import folders_of, modules_in

Completer = Callable[[typer.Context, list[str], str], list[str]]
DEFAULT_STORE = "store"


def _silent(complete: Completer) -> Completer:
    @functools.wraps(complete)
    def completed(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
        try:
            return [text for text in complete(ctx, args, incomplete) if text.startswith(incomplete)]
        except Exception:
            return []

    return completed


@_silent
def complete_workflow(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """YAML files and folders; while no folder is typed, also the files in `workflows`."""
    return _yaml_files(incomplete, Path("workflows"))


@_silent
def complete_vars(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """YAML files and folders; while no folder is typed, also the profiles."""
    return _yaml_files(incomplete, Path("workflows/profiles"))


def _yaml_files(incomplete: str, usual: Path) -> list[str]:
    folder, _, _ = incomplete.rpartition("/")
    start = f"{folder}/" if "/" in incomplete else ""
    found = [
        f"{start}{entry.name}{'/' if entry.is_dir() else ''}"
        for entry in os.scandir(start or ".")
        if entry.is_dir() or entry.name.endswith((".yaml", ".yml"))
    ]
    if not start:
        found += [str(path) for path in usual.glob("*.yaml")]
    return sorted(name for name in found if not name.startswith("."))


@_silent
def complete_stage(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The stages of the workflow on the command line."""
    return list(_document(ctx)["stages"])


@_silent
def complete_setting(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """Vars, parameters of stages, and their values if these are a few words."""
    document, package = _document(ctx), _package(ctx)
    stage, dot, _ = incomplete.partition("=")[0].partition(".")
    if dot:
        settings = _settings_of_stage(stage, document["stages"][stage], package, incomplete)
    else:
        settings = _settings_of_vars(document, package, incomplete)
    return [text for text in settings if text != incomplete]


def _settings_of_stage(stage: str, body: Mapping[str, Any], package: str, incomplete: str) -> list[str]:
    """The stage's parameters; or, once only one of them can be meant, the values of that one."""
    parameters = _parameters(body, package)
    name = incomplete.partition("=")[0].removeprefix(f"{stage}.")
    meant = [name] if "=" in incomplete else [parameter for parameter in parameters if parameter.startswith(name)]
    if len(meant) == 1 and parameters[meant[0]]:
        return [f"{stage}.{meant[0]}={value}" for value in parameters[meant[0]]]
    return [f"{stage}.{parameter}=" for parameter in parameters]


def _settings_of_vars(document: Mapping[str, Any], package: str, incomplete: str) -> list[str]:
    """Vars with their values, and stages, which lead to their parameters; after `=`, a var's other values."""
    name, equals, _ = incomplete.partition("=")
    values = _values_of_var(name, document["stages"], package) if equals else []
    settings = [f"{var}={_shown(value)}" for var, value in document.get("vars", {}).items()]
    return [f"{name}={value}" for value in values] or [*settings, *(f"{stage}." for stage in document["stages"])]


@_silent
def complete_uses(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The stages that a workflow can use."""
    return [name for folder in folders_of(_package(ctx)) for name in modules_in(folder)]


@_silent
def complete_artifact(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names in the store's folder `latest`, with and without their workflow."""
    names = [f"{link.parent.name}/{link.name}" for link in (_store(ctx) / "latest").glob("*/*")]
    return sorted([*names, *(name.partition("/")[2] for name in names)])


@_silent
def complete_pin(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names of pins."""
    return sorted(path.stem for path in (_store(ctx) / "pins").glob("*.json"))


@_silent
def complete_known_workflow(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names of the workflows that have run."""
    return sorted(path.name for path in (_store(ctx) / "runs").iterdir())


def _document(ctx: typer.Context) -> dict[str, Any]:
    """The workflow file as plain data."""
    from ruamel.yaml import YAML

    # If an option still lacks its value, typer leaves the words before it among the unparsed arguments.
    file = ctx.params.get("workflow") or next(word for word in ctx.args if word.endswith((".yaml", ".yml")))
    return YAML(typ="safe", pure=True).load(Path(file))


def _store(ctx: typer.Context) -> Path:
    return Path(ctx.params.get("store") or os.environ.get("GS_HIDER_STORE") or DEFAULT_STORE)


def _parameters(body: Mapping[str, Any], package: str) -> dict[str, list[str]]:
    """The names of a stage's parameters, each with its possible values if these are a few words."""
    declared = declared_parameters(package, body["uses"])
    return {name: declared[name].choices if name in declared else [] for name in [*body.get("with", {}), *declared]}


def _values_of_var(name: str, stages: Mapping[str, Any], package: str) -> list[str]:
    """The values that a var can have, according to the first parameter set by it that allows only a few."""
    for body in stages.values():
        for parameter, value in body.get("with", {}).items():
            choices = _parameters(body, package)[parameter] if value == f"${{{name}}}" else []
            if choices:
                return choices
    return []


def _package(ctx: typer.Context) -> str:
    return str(ctx.params.get("package") or "stages")


def _shown(value: object) -> str:
    """A var's value as one would type it; empty for lists, mappings, and null: it has to be given."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, str | int | float) else ""
