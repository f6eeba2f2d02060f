"""Files of vars, such as a profile for small machines: they replace a workflow's vars, and are checked like them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import CommandError
from tests.pipeline.helpers import Workspace
from tests.pipeline.test_cli import call

WORKFLOW = """\
vars: {count: 3, note: plain, both: "${note} ${count}", file: null}
stages:
  base: {uses: numbers, with: {count: "${count}", note: "${both}", file: "${file}"}}
"""


@pytest.fixture
def profiled(workspace: Workspace) -> Workspace:
    (workspace.folder / "profiles").mkdir()
    (workspace.folder / "profiles" / "numbers.txt").write_text("1\n2\n")
    write(workspace, "cpu.yaml", "# for two cores\ncount: 5\nfile: numbers.txt\n")
    return workspace.write(WORKFLOW)


def write(workspace: Workspace, name: str, text: str) -> Path:
    path = workspace.folder / "profiles" / name
    path.write_text(text)
    return path


def parameters(workspace: Workspace, *settings: str, vars_files: list[Path]) -> dict[str, object]:
    found = dict(workspace.open(*settings, vars_files=vars_files).graph.nodes["base"].parameters)
    return {name: found[name] for name in ("count", "note")}


def test_a_file_replaces_vars_and_paths_are_relative_to_it(profiled: Workspace) -> None:
    cpu = profiled.folder / "profiles/cpu.yaml"
    assert parameters(profiled, vars_files=[cpu]) == {"count": 5, "note": "plain 5"}
    assert profiled.open(vars_files=[cpu]).graph.nodes["base"].arguments["file"] == str(
        profiled.folder / "profiles/numbers.txt"
    )


def test_later_files_win_and_settings_win_over_all(profiled: Workspace) -> None:
    cpu = profiled.folder / "profiles/cpu.yaml"
    late = write(profiled, "late.yaml", 'count: 7\nnote: "late${count}"\n')
    assert parameters(profiled, vars_files=[cpu, late]) == {"count": 7, "note": "late7 7"}
    assert parameters(profiled, vars_files=[late, cpu]) == {"count": 5, "note": "late5 5"}
    assert parameters(profiled, "count=9", vars_files=[cpu, late]) == {"count": 9, "note": "late9 9"}


def test_null_takes_back_what_the_workflow_states(profiled: Workspace) -> None:
    """The stage's own default then counts."""
    cpu = profiled.folder / "profiles/cpu.yaml"
    null = write(profiled, "null.yaml", "count: null\nboth: null\n")
    own = {"count": 3, "note": ""}
    profiled.write(WORKFLOW.replace("count: 3", "count: 4"))
    assert parameters(profiled, vars_files=[cpu, null]) == own
    assert parameters(profiled, "count=null", "both=null", vars_files=[cpu]) == own
    assert parameters(profiled, vars_files=[null, cpu]) == {"count": 5, "note": ""}


def test_null_is_as_if_nothing_were_stated(workspace: Workspace) -> None:
    """Except where null is a value of the parameter, and where there is no default."""
    workspace.write("stages:\n  base: {uses: numbers}\n").run()
    workspace.write("stages:\n  base: {uses: numbers, with: {count: 4}}\n")
    assert workspace.run("base.count=null").states == {"base": "cached"}
    assert workspace.run("base.count=null", "base.first=1").states == {"base": "ran"}
    workspace.write("stages:\n  key: {uses: draw, with: {seed: 1}}\n")
    assert workspace.open("key.seed=null").graph.nodes["key"].unrepeatable
    workspace.write("stages:\n  said: {uses: say, with: {word: this}}\n")
    (problem,) = workspace.problems("said.word=null")
    assert problem.startswith("--set said.word: parameter 'word': no value was given; expected a text. To give")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "count: 5\nnoet: x\n",
            "2:1: unknown key 'noet' in the vars file; allowed: count, note, both, file; did",
        ),
        ("base.count: 5\n", "1:1: unknown key 'base.count' in the vars file; allowed:"),
        ("count: five\n", "1:8: parameter 'count' should be a valid integer; found \"five\""),
        ("count: 5\n  note: [\n", "2:7: not YAML: mapping values are not allowed here"),
        ("count: 5\ncount: 6\n", "2:1: 'count' appears twice"),
        ("note: ${nought}\n", "1:7: ${nought} is not known; known: ${count}"),
        ("file: null\n", "1:7: the var 'file' has no value; give it with --set file=VALUE"),
        ("- count\n", "1:1: the vars file is a list; expected a mapping"),
        ("", "1:1: the vars file is nothing; expected a mapping"),
        ("file: nowhere.txt\n", "1:7: parameter 'file': there is no file or folder"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(profiled: Workspace, text: str, problem: str) -> None:
    cpu, wrong = profiled.folder / "profiles/cpu.yaml", write(profiled, "wrong.yaml", text)
    found = [line.removeprefix(f"{wrong}:") for line in profiled.problems(vars_files=[cpu, wrong])]
    assert any(line.startswith(problem) for line in found), found


def test_an_overridden_file_is_checked_all_the_same(profiled: Workspace) -> None:
    wrong = write(profiled, "wrong.yaml", "cuont: 5\n")
    found = profiled.problems(vars_files=[wrong, profiled.folder / "profiles/cpu.yaml"])
    assert len(found) == 1
    assert "did you mean 'count'?" in found[0]


def test_a_file_that_cannot_be_read_is_a_wrong_command(profiled: Workspace) -> None:
    nowhere = profiled.folder / "nowhere.yaml"
    with pytest.raises(CommandError, match=r"nowhere\.yaml: cannot read the vars file; found No such file"):
        profiled.open(vars_files=[nowhere])
    binary = profiled.folder / "binary.yaml"
    binary.write_bytes(b"\xff\xfe")
    with pytest.raises(CommandError, match="found it is not UTF-8 text; expected a YAML file"):
        profiled.open(vars_files=[binary])


def test_every_command_takes_them(profiled: Workspace) -> None:
    """Without the file, each of them would fail, since one var has no value."""
    cpu = str(profiled.folder / "profiles/cpu.yaml")
    status, _, err = call(profiled, "run", "--serial", "--vars", cpu)
    assert status == 0, err
    for command, arguments in {
        "status": [],
        "explain": ["base"],
        "accept": ["base"],
        "graph": [],
        "pin": [],
    }.items():
        status, out, err = call(profiled, command, *arguments, "--vars", cpu)
        assert status == 0, f"{command}: {err}"
    assert "count: 5 → 6" in call(profiled, "explain", "base", "--vars", cpu, "--set", "count=6")[1]
    wrong = str(write(profiled, "wrong.yaml", "cuont: 5\n"))
    status, out, err = call(profiled, "status", "--vars", cpu, "--vars", wrong)
    assert (status, out) == (2, "")
    assert err.startswith(f"{wrong}:1:1: unknown key 'cuont'")


def test_what_is_missing_is_told_from_the_last_run(profiled: Workspace) -> None:
    cpu = str(profiled.folder / "profiles/cpu.yaml")
    _, _, never = call(profiled, "status")
    assert "last run" not in never
    assert call(profiled, "run", "--serial", "--vars", cpu, "--set", "note=with a blank")[0] == 0
    status, _, told = call(profiled, "status")
    assert status == 2
    assert "the var 'file' has no value" in told
    assert f"its last run in this store was given --vars {cpu} --set 'note=with a blank'" in told
    _, _, other = call(profiled, "status", "--set", "count=2")
    assert "last run" not in other
    profiled.write(WORKFLOW.replace("file: null", "file: /dev/null").replace("uses: numbers", "uses: nought"))
    _, _, wrong = call(profiled, "status")
    assert "nought" in wrong
    assert "last run" not in wrong
