"""`explain` says which part of a key changed, from what to what."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.code.fingerprint import Code, read_module
from pipeline.plan.changes import changes
from pipeline.plan.explanation import Explanation, as_json, explain, in_words
from pipeline.plan.keys import key_of, key_parts
from pipeline.plan.known import Known
from pipeline.plan.plan import make_plan
from pipeline.store.external_cache import ExternalCache
from pipeline.store.history import History, StageResult
from pipeline.workflow.graph import Node, Source
from tests.pipeline.collecting import collected
from tests.pipeline.helpers import CHAIN, Workspace


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
    project = workspace.write(CHAIN).open()
    node, known = project.graph.nodes["twice"], Known(project.store)
    digests: dict[Source, str | None] = {source: "a" for sources in node.sources.values() for source in sources}
    changed = change(node)
    before, after = key_parts(node, digests), key_parts(changed, digests)
    assert key_of(before) != key_of(after)
    assert len(changes(changed, before, after, known)) == 1
    assert changes(node, before, before, known) == ()


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
    assert reason.startswith("input numbers: the numbers of base changed (")


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
    assert workspace.plan()["base"].reasons == ("the files of file changed: data.txt changed",)


def explained(workspace: Workspace, name: str, *settings: str) -> Explanation:
    project = workspace.open(*settings)
    (explained,) = explain(project.graph, make_plan(project.graph, project.store), project.store, [name])
    return explained


def test_the_way_back_to_what_changed(workspace: Workspace) -> None:
    """Whether the stages in between wait, or have already run again."""
    workspace.write(CHAIN).run()
    told = explained(workspace, "sum", "base.count=2")
    assert told.step.reasons == ("input numbers waits for twice", "input numbers waits for other")
    assert [(cause.way, cause.text) for cause in told.causes] == [
        (("sum", "twice", "base"), "because base: parameter count: 3 → 2")
    ]
    workspace.run("base.count=2", stages=["twice", "other"])
    told = explained(workspace, "sum", "base.count=2")
    assert told.step.state == "run"
    assert [cause.text for cause in told.causes] == ["because base: parameter count: 3 → 2"]
    fields = as_json(told)
    assert json.loads(json.dumps(fields)) == fields
    (cause,) = told.causes
    assert cause.as_json["stage"] == "base"
    assert (cause.as_json["before"], cause.as_json["after"]) == (3, 2)


def test_several_causes_are_told_once_each(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    told = explained(workspace, "sum", "base.count=2", "factor=7.5")
    assert [cause.text for cause in told.causes] == [
        "because twice: parameter factor: 2.0 → 7.5",
        "because base: parameter count: 3 → 2",
    ]


def test_what_a_cached_result_was_made_of(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    told = explained(workspace, "sum")
    project = workspace.open()
    lines = in_words(told, project.graph, "2 s")
    assert lines[0] == "sum: cached"
    (journal,) = project.store.history.journals("chain")
    assert lines[1].startswith("  made 2")
    assert lines[1].endswith(f", in run chain/{journal.stem}")
    assert any(line.startswith("  input numbers: twice.numbers (") and ", other.numbers (" in line for line in lines)
    made = as_json(told)["made"]
    assert isinstance(made, dict)
    assert made["run"] == f"chain/{journal.stem}"


def test_the_run_that_made_a_cached_result_is_told_after_a_gc(workspace: Workspace) -> None:
    """`gc` keeps more journals than those of the runs whose results it keeps."""
    made = workspace.write(CHAIN).run("factor=2").project.store.history.journals("chain")[0].stem
    workspace.run("factor=3")
    collected(workspace, keep_last=1)
    assert explained(workspace, "base", "factor=3").run == f"chain/{made}"


def test_which_files_of_a_folder(workspace: Workspace, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a", "b", "c", "d"):
        (folder / f"{name}.txt").write_text(f"{name}\n")
    cache = ExternalCache(workspace.write(CHAIN).open().store)
    before = cache.digest(folder)
    (folder / "a.txt").write_text("1\n")
    (folder / "b.txt").rename(folder / "z.txt")
    (folder / "c.txt").unlink()
    (folder / "n.txt").write_text("n\n")
    after = cache.digest(folder)
    project = workspace.open()
    node = replace(project.graph.nodes["base"], external={"file": (after,)})
    parts = key_parts(node, {})
    old = {**parts, "external": {"file": [before]}}
    (change,) = changes(node, old, parts, Known(project.store))
    words = "a.txt changed, n.txt added, c.txt removed, b.txt renamed to z.txt"
    assert change.text == f"the files of file changed: {words}"
    assert change.as_json["renamed"] == {"b.txt": "z.txt"}
    assert change.as_json["files"] == {"changed": ["a.txt"], "added": ["n.txt"], "removed": ["c.txt"]}


def test_which_definitions_of_a_module(workspace: Workspace) -> None:
    project = workspace.write(CHAIN).open()
    texts = {
        "old": "import a\nX = 1\nY = 2\n\ndef f(): return 1\n\nclass C:\n    z = 1\n\nif X: pass\n",
        "new": "import b\nX = 3\nW = 2\n\ndef f(): return 1\n\nclass C:\n    z = 2\n\nif W: pass\n",
        "moved": "W = 2\nX = 3\nimport b\n\ndef f(): return 1\n\nclass C:\n    z = 2\n\nif W: pass\n",
    }
    for name, text in texts.items():
        file = workspace.folder / "module.py"
        file.write_text(text)
        module = read_module("module", file)
        project.store.keep_code(name, {"module": module.digest}, {"module": module.definitions})
    node = project.graph.nodes["base"]
    parts = {name: {**key_parts(node, {}), "code": name} for name in texts}
    known = Known(project.store)
    (change,) = changes(node, parts["old"], parts["new"], known)
    said = "C, X, its imports, its other statements changed, W added, Y removed"
    assert change.text == f"code changed: module ({said})"
    (change,) = changes(node, parts["new"], parts["moved"], known)
    assert change.text == "code changed: module (the order of its definitions)"
    (change,) = changes(node, {**parts["old"], "code": "unknown"}, parts["new"], known)
    assert change.text == "code changed"


def test_results_of_another_workflow_are_found_by_key(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    workspace.write(CHAIN.replace("name: chain", "name: another"))
    assert {step.state for step in workspace.plan().values()} == {"cached"}


def test_a_journal_is_read_no_oftener_for_many_stages(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for who made what is cached, and once for who made what the others took, even for a thousand stages."""
    workspace.write(CHAIN).run()
    workspace.run("base.count=2")
    project = workspace.open("base.count=2", "twice.factor=7.0")
    steps = make_plan(project.graph, project.store)
    read: Counter[Path] = Counter()
    results = History.results

    def counted(history: History, journal: Path) -> dict[str, StageResult]:
        read[journal] += 1
        return results(history, journal)

    monkeypatch.setattr(History, "results", counted)
    told = list(explain(project.graph, steps, project.store, [*steps, *steps]))
    assert [each.step.name for each in told] == [*steps, *steps]
    newest = project.store.history.journals(project.graph.workflow)[0].stem
    assert {each.run for each in told if each.record} == {f"chain/{newest}"}
    assert {cause.text for each in told for cause in each.causes} == {"because twice: parameter factor: 2.0 → 7.0"}
    assert max(read.values()) == 2


def test_an_item_of_which_an_input_gathers_two_stages_is_told_of_once(workspace: Workspace) -> None:
    project = workspace.write(CHAIN).open()
    node, known = project.graph.nodes["base"], Known(project.store)
    same = {"stage": "a", "version": 1, "parameters": {}, "code": {}, "external": {}, "inputs": {}}
    same |= {"private": False, "format": 1}
    found = [same | {"items": {"scores": [["#4", digest, None], ["#4", digest, None]]}} for digest in ("old", "new")]
    assert [change.text for change in changes(node, *found, known)] == ["input scores: the values of #4 changed"]
