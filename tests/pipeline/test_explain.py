"""`explain` says in words which part of a key changed, from what to what."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.explain import changes, key_of, key_parts
from pipeline.fingerprint import Code
from pipeline.graph import Node, Source
from pipeline.store import sealed
from tests.pipeline.helpers import Workspace
from tests.pipeline.test_runner import CHAIN


@pytest.mark.parametrize(
    "change",
    [
        lambda node: replace(node, declaration=replace(node.declaration, version=2)),
        lambda node: replace(node, declaration=replace(node.declaration, uses="other")),
        lambda node: replace(node, code=Code({**node.code.modules, "tests.pipeline.toys.scale": "other"}, (), ())),
        lambda node: replace(node, parameters={"factor": 2.5}),
        lambda node: replace(node, external={"file": ("other",)}),
        lambda node: replace(node, private=True),
    ],
)
def test_every_part_is_in_the_key_and_explained(workspace: Workspace, change: Callable[[Node], Node]) -> None:
    node = workspace.write(CHAIN).open().graph.nodes["twice"]
    digests: dict[Source, str | None] = {source: "a" for sources in node.sources.values() for source in sources}
    changed = change(node)
    before, after = key_parts(node, digests), key_parts(changed, digests)
    assert key_of(before) != key_of(after)
    assert len(changes(changed, before, after, node.code.modules)) == 1
    assert changes(node, before, before, node.code.modules) == []


def test_never_run(workspace: Workspace) -> None:
    step = workspace.write(CHAIN).plan()["base"]
    assert (step.state, step.reasons) == ("run", ("it has never run",))


def test_a_changed_parameter_and_what_waits_for_it(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    plan = workspace.plan("factor=3.5")
    assert {name: step.state for name, step in plan.items()} == {
        "base": "cached",
        "twice": "run",
        "other": "cached",
        "sum": "depends",
    }
    assert plan["twice"].reasons == ("parameter factor: 2.0 → 3.5",)
    assert plan["sum"].reasons == ("input numbers waits for twice",)
    assert plan["sum"].key is None


def test_another_input(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    workspace.run("base.count=2", stages=["base"])
    (reason,) = workspace.plan("base.count=2")["twice"].reasons
    assert reason.startswith("input numbers: base made another numbers (")


def test_fewer_inputs_and_privacy(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    workspace.write(
        CHAIN.replace("[twice, other.numbers]", "twice").replace("uses: total,", "uses: total, private: true,")
    )
    assert workspace.plan()["sum"].reasons == ("input numbers: 2 → 1 artifacts", "private: false → true")


def test_changed_files(workspace: Workspace, tmp_path: Path) -> None:
    (tmp_path / "data.txt").write_text("1\n")
    workspace.write("stages:\n  base: {uses: numbers, with: {file: data.txt}}\n").run()
    (tmp_path / "data.txt").write_text("2\n")
    assert workspace.plan()["base"].reasons == ("the files of file changed",)


def test_changed_code(workspace: Workspace) -> None:
    """The store holds the digest of each module behind a result, so the one that changed can be named."""
    ran = workspace.write(CHAIN).run()
    modules = {**ran.project.graph.nodes["base"].code.modules, "tests.pipeline.toys.old": "before"}
    modules["tests.pipeline.toys"] = "before"
    code = Code(modules, (), ())
    ran.project.store.keep_code(code.digest, code.modules)
    key = str(ran.ended["base"].key)
    file = workspace.folder / "store/actions" / key / "record.json"
    record = json.loads(file.read_text())
    record["parts"]["code"] = code.digest
    record["key"] = "0" * 64
    del record["sha256"]
    before = ran.project.store.history.journals("chain")[0]
    before.write_text(before.read_text().replace(key, "0" * 64))
    file.write_text(sealed(record))
    file.parent.rename(file.parent.with_name("0" * 64))
    assert workspace.plan()["base"].reasons == (
        "code changed: tests.pipeline.toys",
        "code no longer used: tests.pipeline.toys.old",
    )


def test_results_of_another_workflow_are_found_by_key(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    workspace.write(CHAIN.replace("name: chain", "name: another"))
    assert {step.state for step in workspace.plan().values()} == {"cached"}
