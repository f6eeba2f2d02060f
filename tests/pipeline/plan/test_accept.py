"""`accept` keeps results after a change of code alone; they, and what is made from them, say so."""

from __future__ import annotations

import importlib
import json
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import CommandError
from pipeline.plan.accept import keep, still_to_accept
from pipeline.plan.explanation import explain, in_words
from tests.pipeline.helpers import Workspace
from tests.pipeline.model import StageNode
from tests.pipeline.test_never_stale import Session, forget


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    nodes = [
        StageNode("s0", "source", [], {"base": 2}),
        StageNode("s1", "transform", [0], {}),
        StageNode("s2", "merge", [0, 1], {}),
    ]
    with Session(tmp_path, nodes, []) as session:
        yield session


def ran(session: Session) -> dict[str, str]:
    prepare(session)
    return session.workspace.run().states


def prepare(session: Session) -> None:
    session.world.write()
    forget(session.world.package)
    importlib.invalidate_caches()


def call(session: Session, command: str, *arguments: str) -> tuple[int, str]:
    prepare(session)
    workspace = session.workspace
    where = ["--store", str(workspace.folder / "store"), "--stages", workspace.package]
    done = CliRunner().invoke(app, [command, str(workspace.file), *arguments, *where])
    return done.exit_code, done.output


def words(session: Session, name: str) -> list[str]:
    prepare(session)
    project = session.workspace.open()
    (explained,) = explain(project.graph, session.workspace.plan(), project.store, [name])
    return in_words(explained, project.graph, "1 s")


def test_a_cosmetic_change(session: Session) -> None:
    assert set(ran(session).values()) == {"ran"}
    outputs = {name: step.result.outputs for name, step in session.workspace.plan().items() if step.result}
    session.world.code["transform"].unused += 1
    status, said = call(session, "accept", "s1", "--dry-run")
    module = f"{session.world.package}.transform"
    assert (status, said) == (0, f"s1: would be kept although code changed: {module} (UNUSED_0 added)\n")
    assert session.workspace.plan()["s1"].state == "run"
    status, said = call(session, "accept", "s1")
    assert (status, said) == (0, f"s1: kept although code changed: {module} (UNUSED_0 added)\n")
    plan = session.workspace.plan()
    assert {name: step.state for name, step in plan.items()} == dict.fromkeys(["s0", "s1", "s2"], "cached")
    assert {name: step.result.outputs for name, step in plan.items() if step.result} == outputs
    assert set(ran(session).values()) == {"cached"}
    assert words(session, "s1")[-1].endswith(f"although: code changed: {module} (UNUSED_0 added)")
    status, said = call(session, "accept", "s1")
    assert (status, said) == (0, "s1: cached; there is nothing to accept\n")


def test_what_a_run_is_doing_is_not_to_be_accepted(session: Session) -> None:
    """Accepting it would not stop that run."""
    ran(session)
    session.world.code["transform"].unused += 1
    prepare(session)
    project = session.workspace.open()
    key = session.workspace.plan()["s1"].key
    assert key is not None
    with project.store.lock(key):
        assert still_to_accept(project.graph, project.store) == []
    assert still_to_accept(project.graph, project.store) == ["s1"]


def test_nothing_is_accepted_while_results_are_deleted(workspace: Workspace) -> None:
    """The record could name an artifact that is just going."""
    project = workspace.write("stages:\n  a: {uses: numbers}\n").run().project
    with project.store.in_use(alone=True), pytest.raises(CommandError, match="results are being deleted"):
        keep([], project.graph, project.store)


def test_what_is_made_from_it_says_so(session: Session) -> None:
    ran(session)
    session.world.code["source"].unused += 1
    assert call(session, "accept", "s0")[0] == 0
    session.world.nodes[1].given["factor"] = 7
    assert ran(session) == {"s0": "cached", "s1": "ran", "s2": "ran"}
    said = "  made from a result of s0 that was accepted although its code had changed"
    assert words(session, "s1")[-1] == said
    assert words(session, "s2")[-1] == said
    store = session.workspace.open().store
    key = session.workspace.plan()["s0"].key
    assert key is not None
    record = store.record(key)
    assert record is not None
    (note,) = record.accepted
    assert set(note) == {"from", "when", "commit", "changes"}
    assert store.record(note["from"]) is not None


def test_accepted_twice_keeps_both_notes(session: Session) -> None:
    ran(session)
    for _ in range(2):
        session.world.code["source"].unused += 1
        assert call(session, "accept", "s0")[0] == 0
    assert len([line for line in words(session, "s0") if "accepted" in line]) == 2


def test_others_that_changed_too_are_named(session: Session) -> None:
    ran(session)
    session.world.code["lib.c"].unused += 1
    status, said = call(session, "accept", "s0", "--set", "s0.seed=0", "--json")
    assert status == 0
    (told,) = [line for line in said.splitlines() if "changed, too" in line]
    words = shlex.split(told.removeprefix("the code of s2 changed, too: "))
    assert words[:3] == [sys.orig_argv[0], "-m", "pipeline"]
    where = ["--store", str(session.workspace.folder / "store"), "--stages", session.workspace.package]
    assert sorted(words[3:]) == sorted(
        ["accept", str(session.workspace.file), "s2", "--set", "s0.seed=0", "--json", *where]
    )
    assert "s1" not in said
    prepare(session)
    assert CliRunner().invoke(app, words[3:]).exit_code == 0
    assert set(ran(session).values()) == {"cached"}


def test_without_a_stage_all_changes_of_code_are_accepted(session: Session) -> None:
    """What waits for another result is accepted after it; a dry run knows it beforehand and keeps nothing."""
    ran(session)
    before = {name: step.result.outputs for name, step in session.workspace.plan().items() if step.result}
    for name in ("source", "transform", "merge"):
        session.world.code[name].unused += 1
    module = session.world.package
    changed = [f"s0: {{}} although code changed: {module}.source (UNUSED_0 added)"]
    changed += [f"s1: {{}} although code changed: {module}.transform (UNUSED_0 added)"]
    changed += [f"s2: {{}} although code changed: {module}.merge (UNUSED_0 added)"]
    status, said = call(session, "accept", "--dry-run")
    assert (status, said.splitlines()) == (0, [line.format("would be kept") for line in changed])
    assert session.workspace.plan()["s0"].state == "run"
    status, said = call(session, "accept")
    assert (status, said.splitlines()) == (0, [line.format("kept") for line in changed])
    after = session.workspace.plan()
    assert {name: step.result.outputs for name, step in after.items() if step.result} == before
    assert set(ran(session).values()) == {"cached"}
    assert call(session, "accept") == (0, "everything: cached; there is nothing to accept\n")


def test_without_a_stage_what_was_asked_for_is_still_made_anew(session: Session) -> None:
    ran(session)
    session.world.code["source"].unused += 1
    session.world.code["transform"].unused += 1
    session.world.nodes[1].given["factor"] = 9
    status, said = call(session, "accept", "--json")
    assert (status, [json.loads(line)["name"] for line in said.splitlines()]) == (0, ["s0"])
    assert {name: step.state for name, step in session.workspace.plan().items()} == {
        "s0": "cached",
        "s1": "run",
        "s2": "depends",
    }
    status, said = call(session, "accept")
    assert (status, "no stage would run because of a code change alone" in said) == (2, True)


def test_several_that_changed_too_are_accepted_by_one_command(session: Session) -> None:
    text = "stages:\n  s: {foreach: {base: [1, 2, 3]}, uses: source, with: {base: '${item.base}'}}\n"
    prepare(session)
    session.workspace.write(text).run()
    session.world.code["source"].unused += 1
    session.world.write()
    session.workspace.write(text)
    forget(session.world.package)
    where = ["--store", str(session.workspace.folder / "store"), "--stages", session.workspace.package]
    done = CliRunner().invoke(app, ["accept", str(session.workspace.file), "s[1]", *where])
    (told,) = [line for line in done.output.splitlines() if "changed, too" in line]
    names, _, command = told.partition(" changed, too: ")
    assert names == "the code of s[2], s[3]"
    assert shlex.split(command)[3:] == ["accept", str(session.workspace.file), *where]
    assert CliRunner().invoke(app, shlex.split(command)[3:]).exit_code == 0
    assert {step.state for step in session.workspace.plan().values()} == {"cached"}


def test_an_item_that_changed_too_is_named_as_a_shell_takes_it(session: Session) -> None:
    """Without quotes, a shell takes brackets for a pattern of file names."""
    text = "stages:\n  s: {foreach: {base: [1, 2]}, uses: source, with: {base: '${item.base}'}}\n"
    prepare(session)
    session.workspace.write(text).run()
    session.world.code["source"].unused = 1
    session.world.write()
    session.workspace.write(text)
    forget(session.world.package)
    where = ["--store", str(session.workspace.folder / "store"), "--stages", session.workspace.package]
    done = CliRunner().invoke(app, ["accept", str(session.workspace.file), "s[1]", *where])
    assert " 's[2]' " in done.output


def change_parameter(session: Session) -> None:
    session.world.nodes[1].given["factor"] = 9


def change_input(session: Session) -> None:
    session.world.nodes[0].given["base"] = 9


def change_privacy(session: Session) -> None:
    session.world.nodes[1].private = True


def lose_the_result(session: Session) -> None:
    step = session.workspace.plan()["s1"]
    assert step.result
    session.workspace.open().store.delete_object(step.result.outputs["numbers"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (change_parameter, "s1 cannot be accepted: parameter factor: 2 → 9"),
        (change_input, "s1 cannot be accepted: input numbers waits for s0"),
        (change_privacy, "s1 cannot be accepted: private: false → true"),
        (lose_the_result, "s1 cannot be accepted: it has no complete result in the store"),
    ],
)
def test_what_says_what_was_asked_for_is_refused(
    session: Session, change: Callable[[Session], None], said: str
) -> None:
    ran(session)
    change(session)
    session.world.code["transform"].unused += 1
    status, output = call(session, "accept", "s1")
    assert status == 2
    assert said in output
    assert session.workspace.plan()["s1"].state != "cached"


def test_what_only_waits_for_code_names_what_to_accept_first(session: Session) -> None:
    """Running would be the wrong advice: it replaces the result that is to be kept."""
    ran(session)
    session.world.code["source"].unused += 1
    for name in ("s1", "s2"):
        status, said = call(session, "accept", name)
        assert (status, "Only code changed upstream: accept s0 first." in said, "run the stage" in said) == (
            2,
            True,
            False,
        )
    assert call(session, "accept", "s0")[0] == 0
    assert {step.state for step in session.workspace.plan().values()} == {"cached"}


def test_what_waits_for_more_than_code_has_to_run(session: Session) -> None:
    ran(session)
    session.world.code["source"].unused += 1
    session.world.nodes[1].given["factor"] = 9
    said = call(session, "accept", "s2")[1]
    assert "run the stage" in said
    assert "first" not in said


def test_a_pin_after_a_change_of_code_names_what_to_accept(session: Session) -> None:
    ran(session)
    session.world.code["source"].unused += 1
    session.world.code["merge"].unused += 1
    said = "Only code changed, in s0: `accept` keeps these results; a run may make others."
    status, told = call(session, "pin")
    assert (status, said in told, "Run it first" in told) == (2, True, False)
    for name in ("s0", "s2"):
        assert call(session, "accept", name)[0] == 0
    assert call(session, "pin")[0] == 0
    session.world.nodes[0].given["base"] = 9
    assert "Run it first" in call(session, "pin", "--name", "another")[1]


def test_what_never_ran_is_refused(session: Session) -> None:
    status, said = call(session, "accept", "s0")
    assert (status, "no complete result" in said) == (2, True)


STAGE = """
from pydantic import Field
from pipeline.stage import Context, Output, Parameters, stage

class Inner(Parameters):
    zeta: int = Field(5, description="Before alpha.")
    alpha: int = Field(2, description="After zeta.")

class StageParameters(Parameters):
    inner: Inner = Field(Inner(), description="Nested.")

@stage(inputs={}, outputs={"old": Output("numbers")}, version=1)
def base(context: Context, parameters: StageParameters) -> None:
    context.output("old").attributes["one"] = 1
"""


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ('"old"', '"new"', "base cannot be accepted: its outputs are now new; its result has old"),
        ('"numbers")', '"numbers", privacy="private")', "its output old is now private; its result is public"),
        ('"numbers")', '"letters")', "its output old is now of kind letters; its result is of kind numbers"),
        ('"one"] = 1', '"one"] = 1  # the same', ""),
    ],
)
def test_outputs_that_are_no_longer_those_of_the_stage_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, was: str, now: str, said: str
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "own_stages" / "base.py"
    module.parent.mkdir()
    (module.parent / "__init__.py").write_text("")
    module.write_text(STAGE)
    workspace = Workspace(tmp_path, "own_stages").write("stages:\n  base: {uses: base}\n")
    workspace.run()
    module.write_text(STAGE.replace(was, now) + "ADDED = 1\n")
    forget("own_stages")
    where = ["--store", str(tmp_path / "store"), "--stages", "own_stages"]
    done = CliRunner().invoke(app, ["accept", str(workspace.file), "base", *where])
    assert (done.exit_code, said in done.output) == (2 if said else 0, True), done.output
    assert ("run the stage" in done.output) == bool(said)
    forget("own_stages")
    assert workspace.plan()["base"].state == ("run" if said else "cached")
    forget("own_stages")


def test_an_item_that_cannot_be_kept_holds_up_no_other(session: Session, tmp_path: Path) -> None:
    workspace: Workspace = session.workspace
    text = "stages:\n  s: {foreach: {base: [1, %d]}, uses: source, with: {base: '${item.base}'}}\n"
    prepare(session)
    workspace.write(text % 2).run()
    session.world.code["source"].unused = 1
    session.world.write()
    workspace.write(text % 3)

    def accept(*options: str) -> tuple[int, str]:
        forget(session.world.package)
        where = ["--store", str(tmp_path / "store"), "--stages", workspace.package]
        done = CliRunner().invoke(app, ["accept", str(workspace.file), "s", *where, *options])
        return done.exit_code, done.stdout

    refused = "s[3] cannot be accepted: it has no complete result in the store"
    for options, kept in ((["--dry-run"], "s[1]: would be kept"), ([], "s[1]: kept")):
        status, said = accept(*options)
        assert (status, kept in said, refused in said) == (0, True, True)
    forget(session.world.package)
    assert {name: step.state for name, step in workspace.plan().items()} == {"s[1]": "cached", "s[3]": "run"}
    assert accept()[0] == 2  # nothing that could be kept is left


def test_one_item_of_a_foreach_or_all(session: Session, tmp_path: Path) -> None:
    workspace: Workspace = session.workspace
    text = "stages:\n  s: {foreach: {base: [1, 2]}, uses: source, with: {base: '${item.base}'}}\n"
    prepare(session)
    workspace.write(text).run()

    def accept(stage: str) -> list[str]:
        forget(session.world.package)
        where = ["--store", str(tmp_path / "store"), "--stages", workspace.package, "--json"]
        done = CliRunner().invoke(app, ["accept", str(workspace.file), stage, *where])
        assert done.exit_code == 0
        return [json.loads(line)["name"] for line in done.stdout.splitlines()]

    for stage, kept in (("s[2]", ["s[2]"]), ("s", ["s[1]"])):
        session.world.code["source"].unused = 1
        session.world.write()
        workspace.write(text)
        assert accept(stage) == kept
    forget(session.world.package)
    assert {step.state for step in workspace.plan().values()} == {"cached"}
    with pytest.raises(CommandError, match="no stage"):
        workspace.open().graph.needed_for(["t"])
