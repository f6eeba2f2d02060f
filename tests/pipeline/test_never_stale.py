"""Never stale, never needlessly rerun: random worlds, random edits, and a model that says what must run.

After every edit, the stages that run are exactly those of the model, they hold what it computes, and the plan said so
before. At the end, a run into an empty store makes the same artifacts bit for bit.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.plan.explanation import explain, in_words
from pipeline.plan.plan import make_plan
from pipeline.resources import Resources
from pipeline.run.executor import SerialExecutor, Work
from tests.pipeline.helpers import Ran, Workspace
from tests.pipeline.model import DEFAULTS, KINDS, TEMPLATES, Folder, StageNode, World

CODE = [name for name in TEMPLATES if "__init__" not in name]


@st.composite
def worlds(draw: st.DrawFn) -> tuple[list[StageNode], list[Folder]]:
    """A stage of each kind, both methods, and up to three more stages, each of which takes from earlier ones."""
    nodes, folders = whole_world()
    for index in range(len(nodes), draw(st.integers(5, 8))):
        kind = draw(st.sampled_from(KINDS))
        before = st.integers(0, index - 1)
        inputs = draw(st.lists(before, min_size=1, max_size=3)) if kind == "merge" else [draw(before)]
        folder = draw(st.sampled_from([None, 0, 1])) if kind == "source" else None
        nodes.append(StageNode(f"s{index}", kind, [] if kind == "source" else inputs, {}, folder))
    return nodes, folders


def whole_world() -> tuple[list[StageNode], list[Folder]]:
    nodes = [
        StageNode("s0", "source", [], {}, folder=0),
        StageNode("s1", "transform", [0], {}),
        StageNode("s2", "coarse", [1], {}),
        StageNode("s3", "transform", [2], {"method": "m1"}),
        StageNode("s4", "merge", [3, 0], {}),
    ]
    return nodes, [Folder("photos0", {"a.jpg": b"1", "b.jpg": b"22"}), Folder("photos1", {"a.jpg": b"1"})]


def any_node(world: World, data: st.DataObject, kind: str | None = None) -> StageNode:
    return data.draw(st.sampled_from([node for node in world.nodes if kind in (None, node.kind)]))


def set_parameter(world: World, data: st.DataObject) -> None:
    node = any_node(world, data)
    name = data.draw(st.sampled_from(sorted(DEFAULTS[node.kind])))
    choice = st.sampled_from(["m0", "m1"]) if name == "method" else st.integers(1, 4)
    node.given[name] = data.draw(choice)


def state_a_default(world: World, data: st.DataObject) -> None:
    node = any_node(world, data)
    node.given = dict(node.parameters)


def edit_comments(world: World, data: st.DataObject) -> None:
    world.code[data.draw(st.sampled_from(CODE))].text += " And more."


def edit_a_constant(world: World, data: st.DataObject) -> None:
    world.code[data.draw(st.sampled_from(CODE))].constant = data.draw(st.integers(1, 9))


def add_a_definition(world: World, data: st.DataObject) -> None:
    """It changes no result, so what takes from the result does not run again."""
    world.code[data.draw(st.sampled_from(list(TEMPLATES)))].unused += 1


def raise_a_version(world: World, data: st.DataObject) -> None:
    world.code[data.draw(st.sampled_from(KINDS))].version += 1


def edit_the_kernel(world: World, data: st.DataObject) -> None:
    world.kernel = data.draw(st.sampled_from([b"float x;", b"float y;", b"float x; // said"]))


def replace_a_photo(world: World, data: st.DataObject) -> None:
    files = data.draw(st.sampled_from(world.folders)).files
    name = data.draw(st.sampled_from(sorted(files)))
    files[name] = bytes(data.draw(st.permutations(files[name] + b"\1")))[: len(files[name])]


def rename_a_photo(world: World, data: st.DataObject) -> None:
    files = data.draw(st.sampled_from(world.folders)).files
    name = data.draw(st.sampled_from(sorted(files)))
    files["z" + name] = files.pop(name)


def add_a_photo(world: World, data: st.DataObject) -> None:
    files = data.draw(st.sampled_from(world.folders)).files
    files[f"n{len(files)}.jpg"] = b"new"


def touch_photos(world: World, data: st.DataObject) -> None:
    for path in world.root.glob("photos*/*"):
        path.touch()


def rename_a_folder(world: World, data: st.DataObject) -> None:
    world.rename_folder(data.draw(st.integers(0, len(world.folders) - 1)))


def rename_a_stage(world: World, data: st.DataObject) -> None:
    any_node(world, data).name += "x"


def reorder_the_file(world: World, data: st.DataObject) -> None:
    world.order = data.draw(st.permutations(range(len(world.nodes))))


def use_variables(world: World, data: st.DataObject) -> None:
    world.through_vars = not world.through_vars


def make_private(world: World, data: st.DataObject) -> None:
    node = any_node(world, data)
    node.private = not node.private


EDITS: list[Callable[[World, st.DataObject], None]] = [
    set_parameter,
    state_a_default,
    edit_comments,
    edit_a_constant,
    edit_a_constant,
    add_a_definition,
    raise_a_version,
    edit_the_kernel,
    replace_a_photo,
    rename_a_photo,
    add_a_photo,
    touch_photos,
    rename_a_folder,
    rename_a_stage,
    reorder_the_file,
    use_variables,
    make_private,
]
HARMLESS = {
    edit_comments,
    state_a_default,
    touch_photos,
    rename_a_folder,
    rename_a_stage,
    reorder_the_file,
    use_variables,
}
assert set(EDITS) > HARMLESS


@pytest.fixture(scope="module", autouse=True)
def _quiet_imports() -> Iterator[None]:
    """Python tells compiled files apart by size and whole seconds, which is too coarse for such quick edits."""
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    yield
    sys.dont_write_bytecode = before


def forget(package: str) -> None:
    """Forgets a package's modules, as a new process would."""
    importlib.invalidate_caches()
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        del sys.modules[name]


def check(world: World, workspace: Workspace) -> Ran:
    """Plans and runs, and compares both with the model."""
    world.write()
    forget(world.package)
    values, new, recipes = world.expected()
    project = workspace.open()
    plan = make_plan(project.graph, project.store)
    for name, step in plan.items():
        (explanation,) = explain(project.graph, plan, project.store, [name])
        explained = in_words(explanation, project.graph, "1 s")
        assert explained
        assert (step.state == "cached") <= (recipes[name] not in new), f"{name}: a stale result would be used"
        assert (step.state == "run") <= (recipes[name] in new), f"{name} would be run needlessly: {step.reasons}"
    ran = workspace.run()
    started: set[object] = set()
    for name, state in ran.states.items():
        expected = "ran" if recipes[name] in new - started else "cached"
        started.add(recipes[name])
        assert state == expected, f"{name}: {state} {plan[name].reasons}"
        assert (int(ran.values(name)[0]), ran.artifact(name).private) == values[name], name
    world.made |= {recipe: values[name] for name, recipe in recipes.items()}
    return ran


class Session:
    """A world on the disk and its workspace; the package of each session has a name of its own."""

    count = 0

    def __init__(self, root: Path, nodes: list[StageNode], folders: list[Folder]) -> None:
        Session.count += 1
        self.world = World(root, f"world{Session.count}", nodes, folders)
        self.workspace = Workspace(root, self.world.package)

    def __enter__(self) -> Session:
        sys.path.insert(0, str(self.world.root))
        return self

    def __exit__(self, *error: object) -> None:
        sys.path.remove(str(self.world.root))
        forget(self.world.package)


class Edited(SerialExecutor):
    """Someone edits after the plan, just before a stage begins."""

    def __init__(self, edit: Callable[[], object]) -> None:
        super().__init__()
        self._edit = edit

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        self._edit()
        super().start(name, work, subject, urgency, needs)


def live(nodes: list[StageNode], folders: list[Folder], data: st.DataObject, edits: int) -> None:
    with TemporaryDirectory() as folder, Session(Path(folder), nodes, folders) as session:
        check(session.world, session.workspace)
        for _ in range(edits):
            edit = data.draw(st.sampled_from(EDITS))
            edit(session.world, data)
            ran = check(session.world, session.workspace)
            if edit in HARMLESS:
                assert set(ran.states.values()) == {"cached"}, edit.__name__
        forget(session.world.package)
        (session.workspace.folder / "store").rename(session.workspace.folder / "used")
        anew = session.workspace.run()
        assert {name: (end.key, {o: p.name for o, p in end.outputs.items()}) for name, end in anew.ended.items()} == {
            name: (end.key, {o: p.name for o, p in end.outputs.items()}) for name, end in ran.ended.items()
        }


def test_every_edit_of_every_file() -> None:
    with TemporaryDirectory() as folder, Session(Path(folder), *whole_world()) as session:
        check(session.world, session.workspace)
        for name, file in session.world.code.items():
            if "__init__" not in name:
                file.constant += 1
                check(session.world, session.workspace)
            file.unused += 1
            check(session.world, session.workspace)
            file.text += " And more."
        assert set(check(session.world, session.workspace).states.values()) == {"cached"}
        files = session.world.folders[0].files
        for name, data in (("a.jpg", b"2"), ("b.jpg", b"33"), ("deep.jpg", b"")):
            files[name] = data
            check(session.world, session.workspace)
        session.world.rename_folder(0)
        assert set(check(session.world, session.workspace).states.values()) == {"cached"}
        for kernel in (b"float y;", b"float y; // said", b"float x;"):
            session.world.kernel = kernel
            check(session.world, session.workspace)


def test_code_that_changes_between_plan_and_work_fails_the_stage() -> None:
    with TemporaryDirectory() as folder, Session(Path(folder), *whole_world()) as session:
        session.world.write()
        session.world.code["lib.c"].constant += 1
        ran = session.workspace.run(executor=Edited(session.world.write))
        assert ran.states["s0"] == "failed"
        assert f"found another version of {session.world.package}.lib.c" in str(ran.ended["s0"].cause)
        check(session.world, session.workspace)


def test_code_that_was_loaded_before_it_was_edited_fails_the_stage() -> None:
    """As in a cluster's worker that has run for days."""
    with TemporaryDirectory() as folder, Session(Path(folder), *whole_world()) as session:
        check(session.world, session.workspace)
        session.world.code["lib.c"].constant += 1
        session.world.write()
        ran = session.workspace.run()
        assert ran.states["s0"] == "failed"
        assert f"found another version of {session.world.package}.lib.c" in str(ran.ended["s0"].cause)
        check(session.world, session.workspace)


def test_files_that_change_between_plan_and_work_fail_the_stage() -> None:
    with TemporaryDirectory() as folder, Session(Path(folder), *whole_world()) as session:
        session.world.write()
        photo = session.world.root / "photos0/a.jpg"
        ran = session.workspace.run(executor=Edited(lambda: photo.write_bytes(b"9")))
        assert ran.states["s0"] == "failed"
        assert "photos0: changed since the run began. Run again." in str(ran.ended["s0"].cause)
        session.world.folders[0].files["a.jpg"] = b"9"
        check(session.world, session.workspace)


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(world=worlds(), data=st.data())
def test_what_must_run_runs_and_nothing_else(world: tuple[list[StageNode], list[Folder]], data: st.DataObject) -> None:
    live(*world, data, edits=6)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(world=worlds(), data=st.data())
def test_what_must_run_runs_and_nothing_else_at_length(
    world: tuple[list[StageNode], list[Folder]], data: st.DataObject
) -> None:
    live(*world, data, edits=20)
