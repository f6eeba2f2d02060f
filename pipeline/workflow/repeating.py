"""The command that runs a workflow as it is being run, for pages that say how they were made.

It should hold on other machines, and pages are shown around. So it leaves out this machine's paths, and the values of
settings that reach only private stages, or none. Options that change no result (`--store`, `--workers`, which stages)
are not in it.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pipeline.canonical import Json
from pipeline.errors import Place
from pipeline.store.external import from_home, resolved
from pipeline.workflow.graph import Graph, Node
from pipeline.workflow.located import Located, Problems, read_yaml
from pipeline.workflow.substitution import REFERENCE
from pipeline.workflow.workflow import Workflow

FOLDER, FILE, PRIVATE = "FOLDER", "FILE", "PRIVATE"
"""What stands for a folder or file of this machine, and for a private value."""


def command_of(
    file: Path, settings: Sequence[str], vars_files: Sequence[Path], workflow: Workflow, graph: Graph
) -> str:
    """The command that runs the workflow in `file` with these settings and files of vars, which gave `graph`."""
    words = ["python", "-m", "pipeline", "run", _near(file)]
    for vars_file in vars_files:
        words += ["--vars", _near(vars_file)]
    telling = _Telling(workflow, graph)
    for setting in settings:
        name, _, text = setting.partition("=")
        words += ["--set", f"{name}={telling.text(name, text)}"]
    return shlex.join(words)


def _near(path: Path) -> str:
    """A path as one would type it in the current folder; only the name if it is not below that."""
    there = path.resolve()
    return there.relative_to(Path.cwd()).as_posix() if there.is_relative_to(Path.cwd()) else path.name


def _makes_private_things(node: Node) -> bool:
    return node.private or all(output.privacy == "private" for output in node.declaration.outputs.values())


def _outside(graph: Graph) -> list[Path]:
    """The files and folders outside the store that stages read."""
    given = [node.arguments.get(name) for node in graph.nodes.values() for name in node.declaration.external]
    paths = [path for value in given for path in (value if isinstance(value, list) else [value])]
    return [Path(path).resolve() for path in paths if isinstance(path, str)]


class _Telling:
    """What may be shown of the values of settings. Each value is judged alone: a row may name a cover and a message."""

    def __init__(self, workflow: Workflow, graph: Graph) -> None:
        self._outside = _outside(graph)
        self._private: dict[Place, bool] = {}
        self._is_any_private = any(map(_makes_private_things, graph.nodes.values()))
        for entry in workflow.entries.values():
            for instance in entry.instances:
                is_private = _makes_private_things(graph.nodes[instance.name])
                for given in (*instance.parameters.values(), *instance.resources.values()):
                    for place in given.places():
                        self._private[place] = self._private.get(place, True) and is_private

    def text(self, name: str, text: str) -> str:
        """The value of a setting: as it was typed if all of it may be shown, otherwise with placeholders."""
        place = Place(f"--set {name}")
        value = read_yaml(text, place.file, Path.cwd(), Problems(), fixed=place)
        if value is None:
            return text
        told = self._told(value)
        if told == value.plain:
            return text
        if all(leaf in (PRIVATE, None) for leaf in _leaves(told)):
            return PRIVATE
        return told if isinstance(told, str) else json.dumps(told, ensure_ascii=False)

    def _told(self, value: Located) -> Json:
        if isinstance(value.value, Mapping):
            return {name: self._told(item) for name, item in value.value.items()}
        if isinstance(value.value, tuple):
            return [self._told(item) for item in value.value]
        if _is_path(value, self._outside):
            return FILE if _there(value).is_file() else FOLDER
        return PRIVATE if self._is_private(value) else value.plain

    def _is_private(self, value: Located) -> bool:
        """Whether a value reaches only private stages, or none although there are some: it may name what they hide.

        A reference such as `${item.seed}` is not a value: what it stands for is looked at where that is given.
        """
        if isinstance(value.value, str) and value.value != "$$" and REFERENCE.fullmatch(value.value):
            return False
        return value.value is not None and self._private.get(value.place, self._is_any_private)


def _leaves(told: Json) -> Iterator[Json]:
    if isinstance(told, dict | list):
        for item in told.values() if isinstance(told, dict) else told:
            yield from _leaves(item)
    else:
        yield told


def _is_path(value: Located, outside: Sequence[Path]) -> bool:
    """Whether a value looks like a path, or leads to something that stages read."""
    text = value.value
    if not isinstance(text, str) or not text or text.startswith("${"):
        return False
    return "/" in text or os.sep in text or any(path.is_relative_to(_there(value)) for path in outside)


def _there(value: Located) -> Path:
    return resolved(value.base / from_home(str(value.value)))
