"""Which edits of the real sources change the keys of which stages of the real workflows.

The sources are copied and edited; keys are compared as if all inputs stayed the same, so nothing runs.
"""

from __future__ import annotations

import ast
import importlib.util
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pipeline.code import fingerprint
from pipeline.console.project import open_project
from pipeline.plan.keys import key_of, key_parts
from pipeline.workflow.graph import Node, Source

ROOT = Path(__file__).parents[2]
PACKAGES = ("stages", "opencl")
WORKFLOWS = ROOT / "workflows"
RENDERING = {"seal", "train_scene", "render_hidden", "hide_scenes", "evaluate", "time_frames", "render_path"}
HIDING = {"seal", "hide_scenes", "evaluate", "time_frames", "render_path"}


class Copied:
    """A copy of the sources, and the workflows' keys according to it."""

    def __init__(self, root: Path, store: Path) -> None:
        self.root = root
        self.store = store
        for package in PACKAGES:
            shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
        self.photos = root / "photos"
        self.photos.mkdir()
        (self.photos / "a.jpg").write_bytes(b"1")
        self._unedited = self._sources()

    def _sources(self) -> dict[Path, bytes]:
        return {file: file.read_bytes() for package in PACKAGES for file in (self.root / package).rglob("*.*")}

    def undo_edits(self) -> None:
        """Files that were not edited are left untouched, so that they are not parsed again."""
        for file, content in self._sources().items():
            if file not in self._unedited:
                file.unlink()
            elif content != self._unedited[file]:
                file.write_bytes(self._unedited[file])

    def nodes(self, *settings: str, workflow: str = "hide_multi") -> dict[str, Node]:
        photos = (f"cover={self.photos}", f"message={self.photos}") if workflow == "hide_photos" else ()
        file = WORKFLOWS / f"{workflow}.yaml"
        return dict(open_project(file, self.store, [*photos, *settings]).graph.nodes)

    def changed(self, edit: Callable[[], None], *settings: str, workflow: str = "hide_multi") -> set[str]:
        """The `uses` of the stages whose keys an edit changes. Fails unless all stages with the same `uses` agree."""
        before = self.nodes(*settings, workflow=workflow)
        edit()
        after = self.nodes(*settings, workflow=workflow)
        changed = {before[name].uses for name in before if key(before[name]) != key(after[name])}
        assert not changed & {before[name].uses for name in before if key(before[name]) == key(after[name])}
        return changed

    def append(self, path: str, text: str = "\nSOMETHING_NEW = 1\n") -> Callable[[], None]:
        def edit() -> None:
            file = self.root / path
            file.write_text(file.read_text() + text)

        return edit


def key(node: Node) -> str:
    same: dict[Source, str | None] = {source: "same" for group in node.sources.values() for source in group}
    return key_of(key_parts(node, same))


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Copied:
    """One copy for all tests, with one store, which caches what sources contain and what stages declare."""
    return Copied(tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("store"))


@pytest.fixture
def copied(tree: Copied, monkeypatch: pytest.MonkeyPatch) -> Iterator[Copied]:
    monkeypatch.setattr(fingerprint, "folders_of", lambda package: (tree.root / package,))
    yield tree
    tree.undo_edits()


@pytest.mark.parametrize("workflow", ["hide_multi", "hide_photos"])
def test_comments_change_nothing(copied: Copied, workflow: str) -> None:
    def comment() -> None:
        for path in copied.root.rglob("*.py"):
            path.write_text("# What a comment says.\n" + path.read_text() + '\n"""What a text says."""\n# And more.\n')

    assert copied.changed(comment, workflow=workflow) == set()


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("stages/report.py", {"report"}),
        ("stages/analysis/page/templates/report.html", {"report"}),
        ("stages/synthesize.py", {"synthesize"}),
        ("stages/scene/reconstruction_process.py", {"sfm"}),
        ("stages/tracing/photograph_process.py", {"synthesize"}),
        ("opencl/kernels/ssim.cl", RENDERING),
        ("opencl/rasterizer.py", RENDERING),
        ("stages/training/loop.py", {"train_scene", "hide_scenes"}),
        ("stages/draw_key.py", {"draw_key"}),
        ("stages/imaging/quantities.py", {"evaluate", "report"}),
        ("stages/imaging/webm.py", {"render_path"}),
        ("opencl/bench/report.py", set()),
    ],
)
def test_an_edit_changes_what_uses_it(copied: Copied, path: str, expected: set[str]) -> None:
    if not (ROOT / path).is_file():
        pytest.fail(f"{path} is no longer there; name another file of that sort")
    assert copied.changed(copied.append(path)) == expected


def test_every_kernel_counts(copied: Copied) -> None:
    program = fingerprint.SourceTree(("opencl",)).module("opencl.program")
    assert program
    assert {copied.root / "opencl" / name for name in program.definitions} >= set(copied.root.rglob("kernels/**/*.cl"))


@pytest.mark.parametrize("edited", ["gs_hider", "homogeneous"])
def test_only_the_selected_method_counts(copied: Copied, edited: str) -> None:
    edit = copied.append(f"stages/hiding/methods/{edited}.py")
    other = {"gs_hider": "homogeneous", "homogeneous": "gs_hider"}[edited]
    assert copied.changed(edit, f"method={other}") == set()
    assert copied.changed(edit, f"method={edited}") == HIDING


def test_one_more_method_changes_nothing(copied: Copied) -> None:
    def add() -> None:
        (copied.root / "stages/hiding/methods/own.py").write_text("SETTINGS = ()\n")

    assert copied.changed(add) == set()


def test_only_the_selected_scene_counts(copied: Copied) -> None:
    before = copied.nodes()
    copied.append("stages/tracing/scenes/reef.py")()
    after = copied.nodes()
    assert {name for name in before if key(before[name]) != key(after[name])} == {"message_photos[reef]"}


def test_the_engine_does_not_count(copied: Copied) -> None:
    for node in copied.nodes().values():
        assert not [module for module in node.code.modules if module.partition(".")[0] == "pipeline"]


def test_what_lies_beside_the_sources_is_declared(copied: Copied) -> None:
    """What a module reads besides Python must be among its `RESOURCES`, or its edits would go unnoticed."""
    sources = fingerprint.SourceTree(PACKAGES)
    declared = {
        path.parent / name
        for path in [*copied.root.glob("stages/**/*.py"), *copied.root.glob("opencl/**/*.py")]
        for module in [sources.module(".".join(path.relative_to(copied.root).with_suffix("").parts))]
        if module
        for name in module.definitions
    }
    for package in PACKAGES:
        for file in (copied.root / package).rglob("*"):
            if file.is_file() and file.suffix != ".py" and file.name != "README.md" and "bench" not in file.parts:
                assert file in declared, f"{file.relative_to(copied.root)} is in no RESOURCES"


@pytest.mark.parametrize("workflow", ["hide_multi", "hide_photos"])
def test_modules_named_in_texts_count(copied: Copied, workflow: str) -> None:
    """A companion is started by its module's name: the stage must declare it, or its edits would go unnoticed."""
    for node in copied.nodes(workflow=workflow).values():
        for module in node.code.modules:
            for named in _modules_named_in(copied, module):
                assert named in node.code.modules, f"{node.name}: {module} names {named}"


def _modules_named_in(copied: Copied, module: str) -> Iterator[str]:
    path = copied.root.joinpath(*module.split("."))
    file = path.with_suffix(".py") if path.with_suffix(".py").is_file() else path / "__init__.py"
    for node in ast.walk(ast.parse(file.read_text())):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and text.startswith(("stages.", "opencl.")) and text.replace(".", "").isidentifier():
            found = copied.root.joinpath(*text.split(".")).with_suffix(".py")
            if found.is_file():
                yield text


def test_the_copy_is_what_is_read(copied: Copied) -> None:
    module = fingerprint.SourceTree(("stages",)).module("stages.report")
    assert module
    assert module.path.is_relative_to(copied.root)
    assert importlib.util.find_spec("stages") is not None
