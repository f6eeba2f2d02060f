"""The command that has a workflow run as it is being run, for pages that say how they were made.

It is to hold on other machines, and pages are shown around: paths of this one are left out, and so are settings of
which only private stages hear. What changes no result (`--store`, `--workers`, which stages) is not in it.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from pipeline.canonical import Json
from pipeline.errors import Place
from pipeline.external import from_home, resolved
from pipeline.graph import Graph, Node
from pipeline.located import Located, Problems, read_yaml
from pipeline.workflow import Workflow

FOLDER, FILE, PRIVATE = "FOLDER", "FILE", "PRIVATE"
"""What stands for a folder or file of this machine, and for a value that is nobody else's affair."""


def command_of(
    file: Path, settings: Sequence[str], vars_files: Sequence[Path], workflow: Workflow, graph: Graph
) -> str:
    """The command for the workflow in `file`, of which `graph` was built with these settings and files of vars."""
    words = ["python", "-m", "pipeline", "run", _near(file)]
    for vars_file in vars_files:
        words += ["--vars", _near(vars_file)]
    for setting in settings:
        name, _, text = setting.partition("=")
        told = _without_paths(text, _outside(graph))
        if told not in (FOLDER, FILE) and _is_private(name, workflow, graph):
            told = PRIVATE
        words += ["--set", f"{name}={told}"]
    return shlex.join(words)


def _near(path: Path) -> str:
    """As one would type it in the current folder; of what lies elsewhere the name alone."""
    there = path.resolve()
    return there.relative_to(Path.cwd()).as_posix() if there.is_relative_to(Path.cwd()) else path.name


def _is_private(setting: str, workflow: Workflow, graph: Graph) -> bool:
    """Whether stages take the value of a setting, and all that do are private."""
    place = Place(f"--set {setting}")
    taking = [
        graph.nodes[instance.name]
        for entry in workflow.entries.values()
        for instance in entry.instances
        if any(parameter.place == place for parameter in instance.parameters.values())
    ]
    return bool(taking) and all(map(_makes_private_things, taking))


def _makes_private_things(node: Node) -> bool:
    return node.private or all(output.privacy == "private" for output in node.declaration.outputs.values())


def _outside(graph: Graph) -> list[Path]:
    """The files and folders that stages read."""
    given = [node.arguments.get(name) for node in graph.nodes.values() for name in node.declaration.external]
    paths = [path for value in given for path in (value if isinstance(value, list) else [value])]
    return [Path(path).resolve() for path in paths if isinstance(path, str)]


def _without_paths(text: str, outside: Sequence[Path]) -> str:
    """The value of a setting, as it was typed where there is no path in it."""
    value = read_yaml(text, "", Path.cwd(), Problems())
    if value is None or not any(_is_path(each, outside) for each in value.texts()):
        return text
    told = _told(value, outside)
    return told if isinstance(told, str) else json.dumps(told, ensure_ascii=False)


def _told(value: Located, outside: Sequence[Path]) -> Json:
    if isinstance(value.value, Mapping):
        return {name: _told(item, outside) for name, item in value.value.items()}
    if isinstance(value.value, tuple):
        return [_told(item, outside) for item in value.value]
    if _is_path(value, outside):
        return FILE if _there(value).is_file() else FOLDER
    return value.plain


def _is_path(value: Located, outside: Sequence[Path]) -> bool:
    """Whether a value looks like the path of something here, or leads to what stages read."""
    text = value.value
    if not isinstance(text, str) or not text or text.startswith("${"):
        return False
    return "/" in text or os.sep in text or any(path.is_relative_to(_there(value)) for path in outside)


def _there(value: Located) -> Path:
    return resolved(value.base / from_home(str(value.value)))
