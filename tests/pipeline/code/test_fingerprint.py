"""Which edits of the code make a stage run again, and which do not."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.provenance import providers
from tests.pipeline.helpers import Workspace

STAGE = '''
"""A stage."""
from pydantic import Field
from pipeline.stage import Context, Output, Parameters, stage
{imports}

class MakeParameters(Parameters):
    method: str = Field("plain", description="Which method.")

@stage(inputs={{}}, outputs={{"made": Output("text")}}, version={version}{modules})
def make(context: Context, parameters: MakeParameters) -> None:
    """Makes."""
    {body}
    context.output("made").write_file("text", repr(parameters.method))  # a comment
'''
SELECT = ", modules=lambda parameters: [f'{package}.methods.{parameters.method}']"
DYNAMIC = "import importlib; importlib.import_module('{package}.methods.' + parameters.method)"


class Package:
    """A package of one stage, `make`, that imports `middle`, which imports `low`."""

    def __init__(self, root: Path) -> None:
        self.name = f"package_{root.name.replace('-', '_')}"
        self.folder = root / self.name
        self.write("__init__.py", '"""Stages."""\n')
        self.write("lib/__init__.py", "")
        self.write("lib/middle.py", "from . import low\nSIZE = low.SIZE\n")
        self.write("lib/low.py", "SIZE = 1\n")
        self.write("lib/other.py", "SIZE = 2\n")
        self.write_stage()

    def write(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def write_stage(self, imports: str | None = None, body: str = "pass", version: int = 1, modules: str = "") -> None:
        imports = imports if imports is not None else f"from {self.name}.lib import middle"
        modules, body = modules.replace("{package}", self.name), body.replace("{package}", self.name)
        self.write("make.py", STAGE.format(imports=imports, version=version, body=body, modules=modules))

    def edit(self, name: str, old: str, new: str) -> None:
        """Dated seconds later: otherwise, code compiled from a text of equal length in that second would be used."""
        path = self.folder / name
        text, later = path.read_text(), path.stat().st_mtime + 2
        assert old in text
        path.write_text(text.replace(old, new))
        os.utime(path, (later, later))


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Package]:
    monkeypatch.syspath_prepend(tmp_path)
    package = Package(tmp_path)
    yield package
    forget(package)


def forget(package: Package) -> None:
    """Forgets its modules, as a new process would."""
    for name in [name for name in sys.modules if name.partition(".")[0] == package.name]:
        del sys.modules[name]


def run(package: Package, tmp_path: Path, *settings: str) -> str:
    forget(package)
    workspace = Workspace(tmp_path, package.name).write("stages:\n  made: {uses: make}\n")
    return workspace.run(*settings).states["made"]


def problems(package: Package, tmp_path: Path) -> list[str]:
    forget(package)
    return Workspace(tmp_path, package.name).write("stages:\n  made: {uses: make}\n").problems()


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("make.py", "# a comment", "# another comment\n\n"),
        ("make.py", '"""Makes."""', '"""Makes something, as is well known."""'),
        ("make.py", "version=1", "version=1, alone=True, resources={'memory': '1 GB'}"),
        ("make.py", 'write_file("text", repr', 'write_file(\n        "text", repr'),
        ("lib/low.py", "SIZE = 1", '"""The size."""\n\nSIZE  =  1  # small\n"""It is small."""'),
        ("__init__.py", "Stages", "All stages"),
        ("lib/other.py", "2", "3"),
    ],
)
def test_edits_that_repeat_nothing(package: Package, tmp_path: Path, name: str, old: str, new: str) -> None:
    assert run(package, tmp_path) == "ran"
    package.edit(name, old, new)
    assert run(package, tmp_path) == "cached"


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("make.py", "pass", "parameters = parameters"),
        ("make.py", 'Field("plain"', 'Field("other"'),
        ("lib/middle.py", "SIZE = low.SIZE", "SIZE = low.SIZE + 1"),
        ("lib/low.py", "SIZE = 1", "SIZE = 1.0"),
        ("lib/low.py", "SIZE = 1", "SIZE = True"),
        ("lib/__init__.py", "", "x = 1\n"),
        ("__init__.py", '"""Stages."""', "import sys"),
    ],
)
def test_edits_that_repeat_the_stage(package: Package, tmp_path: Path, name: str, old: str, new: str) -> None:
    assert run(package, tmp_path) == "ran"
    package.edit(name, old, new) if old else package.write(name, new)
    assert run(package, tmp_path) == "ran"


@pytest.mark.parametrize(
    "imports",
    [
        "from {package}.lib.other import SIZE",
        "import {package}.lib.other",
        "from .lib import other",
        "from .lib.other import *",
        "def f():\n    from {package}.lib import other",
        "import typing\nif typing.TYPE_CHECKING:\n    from {package}.lib import other",
    ],
)
def test_every_way_of_importing_counts(package: Package, tmp_path: Path, imports: str) -> None:
    package.write_stage(imports.replace("{package}", package.name))
    assert run(package, tmp_path) == "ran"
    package.edit("lib/other.py", "2", "3")
    assert run(package, tmp_path) == "ran"


def test_code_that_is_edited_before_the_stage_loads_it_fails_the_stage(package: Package, tmp_path: Path) -> None:
    """Its result would be that of other code than its key says."""
    text = "pathlib.Path(__file__).parent.joinpath('lib', 'other.py').write_text('SIZE = 30')"
    package.write_stage(imports="import pathlib", body=f"{text}; from {{package}}.lib import other")
    assert [run(package, tmp_path), run(package, tmp_path)] == ["failed", "ran"]


def test_version_and_resources_count(package: Package, tmp_path: Path) -> None:
    package.write("lib/low.py", 'RESOURCES = ("kernels/*.cl",)\nSIZE = 1\n')
    package.write("lib/kernels/blend.cl", "float x;")
    assert run(package, tmp_path) == "ran"
    package.write_stage(version=2)
    assert run(package, tmp_path) == "ran"
    package.write("lib/kernels/blend.cl", "float y;")
    assert run(package, tmp_path) == "ran"
    package.write("lib/kernels/project.cl", "float z;")
    assert run(package, tmp_path) == "ran"
    package.write("lib/kernels/notes.txt", "nothing")
    assert run(package, tmp_path) == "cached"


def test_only_the_selected_module_counts(package: Package, tmp_path: Path) -> None:
    package.write("methods/__init__.py", "")
    package.write("methods/plain.py", "A = 1\n")
    package.write("methods/fancy.py", "from ..lib import other\n")
    package.write_stage(body=DYNAMIC, modules=SELECT)
    assert [run(package, tmp_path), run(package, tmp_path, "made.method=fancy")] == ["ran", "ran"]
    package.edit("lib/other.py", "2", "3")
    assert [run(package, tmp_path), run(package, tmp_path, "made.method=fancy")] == ["cached", "ran"]
    package.edit("methods/plain.py", "1", "2")
    assert [run(package, tmp_path), run(package, tmp_path, "made.method=fancy")] == ["ran", "cached"]


def test_what_a_selected_module_says_of_parameters_is_asked_anew(package: Package, tmp_path: Path) -> None:
    """Completed parameters are remembered, and may depend on the module that they select."""
    package.write("methods/__init__.py", "")
    package.write("methods/plain.py", "LAYERS = 1\n")
    package.write_stage(imports="import importlib\nfrom pydantic import model_validator", modules=SELECT)
    package.edit(
        "make.py",
        'description="Which method.")\n',
        f'''description="Which method.")
    layers: int = Field(0, description="Its own.")

    @model_validator(mode="before")
    @classmethod
    def fill_in(cls, stated):
        return {{"layers": importlib.import_module("{package.name}.methods." + "plain").LAYERS}} | stated
''',
    )

    def planned() -> object:
        forget(package)
        workspace = Workspace(tmp_path, package.name).write("stages:\n  made: {uses: make}\n")
        workspace.run()
        return workspace.open().graph.nodes["made"].parameters["layers"]

    assert (planned(), planned()) == (1, 1)
    package.edit("methods/plain.py", "1", "2")
    assert (planned(), planned()) == (2, 2)


def test_what_the_projects_own_package_holds_counts_for_stages_of_another(package: Package, tmp_path: Path) -> None:
    """Otherwise, stages that build on `stages/` would get results of its earlier code."""
    package.write("lib/low.py", "import stages.scene.similarity\nSIZE = 1\n")
    workspace = Workspace(tmp_path, package.name).write("stages:\n  made: {uses: make}\n")
    assert "stages.scene.similarity" in workspace.open().graph.nodes["made"].code.modules


@pytest.mark.parametrize(
    "body",
    [
        DYNAMIC,
        DYNAMIC.replace("importlib.import_module(", "load = importlib.import_module; load("),
        DYNAMIC.replace(
            "import importlib; importlib.import_module(", "from importlib import import_module as load; load("
        ),
    ],
)
def test_hidden_imports_are_errors(package: Package, tmp_path: Path, body: str) -> None:
    package.write_stage(body=body)
    (problem,) = problems(package, tmp_path)
    assert problem.startswith("2:16: the code of make imports modules by computed names")
    assert f"{package.folder / 'make.py'}:" in problem
    assert "@stage(modules=…)" in problem


@pytest.mark.parametrize("file", ["{name}.py", "{name}/__init__.py", "{name}/part.py"])
def test_modules_beside_the_package_are_errors(package: Package, tmp_path: Path, file: str) -> None:
    """No key would notice their changes, as if they were libraries, whose versions are noted."""
    name = f"beside_{package.name}"
    path = tmp_path / file.format(name=name)
    path.parent.mkdir(exist_ok=True)
    path.write_text("SIZE = 1\n")
    package.write("lib/low.py", f"import {name}\nSIZE = 1\n")
    (problem,) = problems(package, tmp_path)
    found = path.parent if path.name == "part.py" else path
    assert problem.startswith(f"2:16: the code of make imports {name} ({found}), whose changes no key would notice")
    assert problem.endswith(f"move it into the package {package.name}, or install it as a library")


@pytest.mark.parametrize("declared", [True, False])
def test_libraries_that_are_installed_elsewhere_are_none(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, declared: bool
) -> None:
    """In place, by pip's `-e`, where not all that lies among the sources need be part of it, or by its `--target`."""
    names = [f"{how}_{package.name}_{declared}" for how in ("targeted", "edited", "stray")]
    target, sources = tmp_path / "target", tmp_path / "sources"
    targeted, edited = target / f"{names[0]}.dist-info", tmp_path / "site-packages" / f"{names[1]}.dist-info"
    for name, folder, about in zip(names, (target, sources, sources), (targeted, edited, None), strict=True):
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.py").write_text("SIZE = 1\n")
        monkeypatch.syspath_prepend(folder)
        if about:
            about.mkdir(parents=True)
            (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
            (about / "RECORD").write_text(f"{name}.py,,\n" if about == targeted else "")
    (edited / "direct_url.json").write_text(f'{{"url": "{sources.as_uri()}", "dir_info": {{"editable": true}}}}')
    if declared:
        (edited / "top_level.txt").write_text(f"{names[1]}\n")
    monkeypatch.syspath_prepend(edited.parent)
    providers.cache_clear()
    package.write("lib/low.py", f"import {', '.join(names)}\nSIZE = 1\n")
    found = problems(package, tmp_path)
    assert [f"imports {names[2]} (" in problem for problem in found] == [True] * declared


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("make.py", "def (", "make.py:1: not Python"),
        ("make.py", "import nothing_of_that_name", "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("make.py", "make = 3", "defines no stage 'make'"),
        ("lib/low.py", 'RESOURCES = ("*.cl",)\nSIZE = 1\n', "RESOURCES names '*.cl', which matches no file"),
        ("lib/low.py", "SIZE = 1\nRESOURCES = [x for x in ()]\n", "RESOURCES is not a literal tuple"),
    ],
)
def test_broken_code_is_a_message(package: Package, tmp_path: Path, name: str, text: str, expected: str) -> None:
    package.write(name, text)
    assert any(expected in problem for problem in problems(package, tmp_path))


def test_a_selected_module_that_is_missing_is_a_message(package: Package, tmp_path: Path) -> None:
    package.write_stage(modules=SELECT)
    (problem,) = problems(package, tmp_path)
    assert problem.startswith(f"2:16: no such module; found {package.name}.methods.plain; expected a module of ")
