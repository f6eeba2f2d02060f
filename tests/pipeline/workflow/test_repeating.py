"""Pages can say which command made them: the same on any machine, and without what is private."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pipeline.helpers import Workspace

WORKFLOW = """
name: toys
vars: {file: null, count: 3, seed: 1, first: 0.5, rows: [{file: null}]}
stages:
  numbers: {uses: numbers, with: {file: "${file}", count: "${count}"}}
  key: {uses: draw, private: true, with: {seed: "${seed}"}}
  shared: {uses: numbers, private: true, with: {count: "${count}", first: "${first}"}}
  others: {foreach: "${rows}", uses: numbers, with: {file: "${item.file}"}}
"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text("1\n2\n")
    monkeypatch.chdir(tmp_path)
    return Workspace(tmp_path).write(WORKFLOW)


def command(workspace: Workspace, *settings: str, vars_files: tuple[Path, ...] = ()) -> str:
    """What follows the name of the workflow, without `--set file=FILE`."""
    said = workspace.open("file=a.txt", *settings, vars_files=vars_files).graph.command
    start = "python -m pipeline run workflow.yaml"
    assert said.startswith(start)
    return said.removeprefix(start).strip().replace("--set file=FILE", "").strip()


def test_it_says_the_settings_in_order(workspace: Workspace) -> None:
    assert command(workspace, "numbers.first=5", "count=4") == "--set numbers.first=5 --set count=4"
    assert command(workspace) == ""


def test_files_of_vars_here_are_said_as_they_lie_and_others_by_name(workspace: Workspace, tmp_path: Path) -> None:
    (tmp_path / "profiles").mkdir()
    here = tmp_path / "profiles" / "my small.yaml"
    elsewhere = tmp_path.parent / f"{tmp_path.name}.yaml"
    for file in (here, elsewhere):
        file.write_text("{count: 4}")
    said = command(workspace, vars_files=(here, elsewhere))
    assert said == f"--vars 'profiles/my small.yaml' --vars {elsewhere.name}"


def test_a_workflow_that_lies_elsewhere_is_said_by_name(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    (workspace.folder / "inner").mkdir()
    monkeypatch.chdir(workspace.folder / "inner")
    said = workspace.open("file=../a.txt").graph.command
    assert said == "python -m pipeline run workflow.yaml --set file=FILE"


def test_what_refers_to_a_private_value_is_said_and_the_value_is_not(workspace: Workspace) -> None:
    assert command(workspace, "key.seed=${count}", "seed=81549") == "--set 'key.seed=${count}' --set seed=PRIVATE"


@pytest.mark.parametrize("typed", ["a.txt", "./a.txt", "{folder}/a.txt"])
def test_paths_are_not_said_however_they_are_typed(workspace: Workspace, typed: str) -> None:
    path = typed.replace("{folder}", str(workspace.folder))
    assert workspace.open(f"file={path}").graph.command.endswith("--set file=FILE")


def test_paths_inside_of_lists_are_not_said(workspace: Workspace) -> None:
    said = command(workspace, f"rows=[{{file: {workspace.folder}/b.txt}}, {{file: a.txt}}]")
    assert said == """--set 'rows=[{"file": "FILE"}, {"file": "FILE"}]'"""


def test_what_only_private_stages_hear_is_not_said(workspace: Workspace) -> None:
    """Values that other stages use as well are given: otherwise, nobody could repeat anything."""
    assert (
        command(workspace, "seed=81549", "count=4", "first=2.5")
        == "--set seed=PRIVATE --set count=4 --set first=PRIVATE"
    )
    assert command(workspace, "shared.file=b.txt") == "--set shared.file=FILE"
    assert command(workspace, "key.seed=81549") == "--set key.seed=PRIVATE"


def test_each_value_in_a_row_is_said_or_not_by_itself(workspace: Workspace) -> None:
    """A cover is public and a message is not, even if it is called like the cover of another row."""
    workspace.write(
        """
        name: toys
        vars: {pairs: null, word: none, place: here}
        stages:
          cover:   {foreach: "${pairs}", uses: numbers, with: {note: "photos/${item.cover}"}}
          message: {foreach: "${pairs}", uses: numbers, private: true, with: {note: "${place}/${item.message}"}}
          other:   {uses: numbers, private: true, with: {note: "the ${word} of all"}}
        """
    )
    command = workspace.open(
        "word=REEF", "place=sea", "pairs=[{cover: fox, message: REEF}, {cover: REEF, message: fox}]"
    )
    rows = '[{"cover": "fox", "message": "PRIVATE"}, {"cover": "REEF", "message": "PRIVATE"}]'
    said = f"--set word=PRIVATE --set place=PRIVATE --set 'pairs={rows}'"
    assert command.graph.command == f"python -m pipeline run workflow.yaml {said}"


def test_what_no_stage_hears_of_is_said_only_where_nothing_is_private(workspace: Workspace) -> None:
    for private, said in (("true", "PRIVATE"), ("false", "REEF")):
        workspace.write(f"name: toys\nvars: {{word: none}}\nstages:\n  key: {{uses: numbers, private: {private}}}\n")
        assert workspace.open("word=REEF").graph.command.endswith(f"--set word={said}")


def test_an_empty_text_is_no_path(workspace: Workspace) -> None:
    assert command(workspace, 'numbers.note=""') == "--set 'numbers.note=\"\"'"


def test_a_part_of_a_workflow_is_said_as_the_whole(workspace: Workspace) -> None:
    graph = workspace.open("file=a.txt").graph
    assert graph.needed_for(["numbers"]).command == graph.command


def test_a_stage_can_ask_for_it(workspace: Workspace) -> None:
    """It is not part of the key: a result stays when another command asks for the same."""
    workspace.write("name: said\nstages:\n  said: {uses: say, with: {word: x}}\n")
    first = workspace.run()
    again = workspace.run("said.word=x")
    assert first.artifact("said").attributes["command"] == "python -m pipeline run workflow.yaml"
    assert again.states == {"said": "cached"}
    other = workspace.run("said.word=y")
    assert other.artifact("said").attributes["command"] == "python -m pipeline run workflow.yaml --set said.word=y"
