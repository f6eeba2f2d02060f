"""What the shell offers when Tab is pressed: workflow files, stages, settings, artifacts and pins.

It is asked in a process of its own while a person waits, so nothing here loads the engine, and where anything is wrong
it offers nothing and stays silent: what is wrong with a workflow is told by the command itself.
"""

from __future__ import annotations

import ast
import functools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import typer

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
    """YAML files and folders where one is typing; those in `workflows` before anything is typed."""
    return _yaml_files(incomplete, Path("workflows"))


@_silent
def complete_vars(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """YAML files and folders where one is typing; the profiles before anything is typed."""
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
    """Vars with their values, and the parameters of stages."""
    document = _document(ctx)
    stage, dot, _ = incomplete.partition(".")
    if dot:
        body = document["stages"][stage]
        names = {**dict.fromkeys(body.get("with", {})), **dict.fromkeys(_parameters(_package(ctx), body["uses"]))}
        return [f"{stage}.{name}=" for name in names]
    settings = [f"{name}={_shown(value)}" for name, value in document.get("vars", {}).items()]
    return [*settings, *(f"{name}." for name in document["stages"])]


@_silent
def complete_artifact(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names in the store's folder `latest`, and folders."""
    names = [f"{link.parent.name}/{link.name}" for link in (_store(ctx) / "latest").glob("*/*")]
    return sorted([*names, *(name.partition("/")[2] for name in names)])


@_silent
def complete_pin(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names of pins."""
    return sorted(path.stem for path in (_store(ctx) / "pins").glob("*.json"))


@_silent
def complete_known_workflow(ctx: typer.Context, args: list[str], incomplete: str) -> list[str]:
    """The names of the workflows that ran."""
    return sorted(path.name for path in (_store(ctx) / "runs").iterdir())


def _document(ctx: typer.Context) -> dict[str, Any]:
    """The workflow file as plain data."""
    from ruamel.yaml import YAML

    # Behind an option that still lacks its value, typer leaves what it read before among the other words.
    file = ctx.params.get("workflow") or next(word for word in ctx.args if word.endswith((".yaml", ".yml")))
    return YAML(typ="safe", pure=True).load(Path(file))


def _store(ctx: typer.Context) -> Path:
    return Path(ctx.params.get("store") or os.environ.get("GS_HIDER_STORE") or DEFAULT_STORE)


def _package(ctx: typer.Context) -> str:
    return str(ctx.params.get("package") or "stages")


def _shown(value: object) -> str:
    """A var's value as one would type it; nothing where it must be given, or is more than a word."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, str | int | float) else ""


def _parameters(package: str, uses: str) -> list[str]:
    """The names of a stage's parameters, read from its source: importing it would take seconds."""
    module = f"{package}.{uses}"
    tree = _parsed(module)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == uses]
    annotation = functions[0].args.args[1].annotation
    return list(_fields(module, annotation.id)) if isinstance(annotation, ast.Name) else []


def _fields(module: str, name: str) -> Iterator[str]:
    """The annotated names in a class, those of its bases first, wherever these are defined."""
    tree = _parsed(module)
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            for base in node.bases:
                if isinstance(base, ast.Name):
                    yield from _fields(module, base.id)
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                    yield field.target.id
        elif isinstance(node, ast.ImportFrom) and node.module and node.module != "pipeline.stage":
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    yield from _fields(node.module, alias.name)


def _parsed(module: str) -> ast.Module:
    for folder in (Path.cwd(), Path(__file__).resolve().parents[1]):
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        if path.is_file():
            return ast.parse(path.read_bytes())
    raise FileNotFoundError(module)
