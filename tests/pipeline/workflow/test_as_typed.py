"""Names that YAML takes for something else: paths are taken as typed, other texts must be quoted as a message says."""

from __future__ import annotations

import pytest

from tests.pipeline.helpers import Workspace

NAMES = ["2024", "0123", "1e5", "1_000", "0x10", "true", "True", "2024-05-01", "Haus: Garten", "{a: b}", "[fox]"]
FILE = "vars: {folder: null}\nstages:\n  a: {uses: numbers, with: {file: '%s'}}\n"


@pytest.fixture
def here(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    monkeypatch.chdir(workspace.folder)
    return workspace


@pytest.mark.parametrize("name", NAMES)
def test_a_path_after_set_is_taken_as_it_was_typed(here: Workspace, name: str) -> None:
    (here.folder / name).mkdir()
    (here.folder / name / "numbers.txt").write_text("1")
    here.write(FILE % "${folder}")
    assert here.open(f"folder={name}").graph.nodes["a"].arguments["file"] == str(here.folder / name)
    assert here.open(f"folder={name}", f"a.file={name}").graph.nodes["a"].arguments["file"] == str(here.folder / name)
    here.write(FILE % "${folder}/numbers.txt")
    inside = here.folder / name / "numbers.txt"
    assert here.open(f"folder={name}").graph.nodes["a"].arguments["file"] == str(inside)


@pytest.mark.parametrize("name", ["2024", "0123", "1e5", "true", "2024-05-01"])
def test_a_path_in_a_file_or_a_table_is_taken_as_it_stands(here: Workspace, name: str) -> None:
    (here.folder / name).write_text("1")
    here.write(f"stages:\n  a: {{uses: numbers, with: {{file: {name}}}}}\n")
    assert here.open().graph.nodes["a"].arguments["file"] == str(here.folder / name)
    (here.folder / "rows.csv").write_text(f"file\n{name}\n")
    here.write("stages:\n  a: {uses: numbers, foreach: rows.csv, with: {file: '${item.file}'}}\n")
    (node,) = here.open().graph.nodes.values()
    assert node.arguments["file"] == str(here.folder / name)


@pytest.mark.parametrize("name", NAMES)
def test_a_path_that_leads_nowhere_is_told_as_it_was_typed(here: Workspace, name: str) -> None:
    here.write(FILE % "${folder}")
    found = here.problems(f"folder={name}")
    if name == "[fox]":  # it may be meant as a list of paths
        assert any("""quote it: '[fox]' in a YAML file, "[fox]" in a CSV, """ in problem for problem in found)
    else:
        said = [problem.partition("; did you mean")[0] for problem in found]
        assert said == [f"--set folder: parameter 'file': there is no file or folder {str(here.folder / name)!r}"]


@pytest.mark.parametrize("name", [name for name in NAMES if name != "2024-05-01"])
def test_a_text_is_to_be_quoted_as_it_was_typed(here: Workspace, name: str) -> None:
    here.write("stages:\n  a: {uses: numbers}\n")
    (problem,) = here.problems(f"a.note={name}")
    assert f"""quote it: '{name}' in a YAML file, "{name}" in a CSV, "'{name}'" after --set NAME=""" in problem
    assert here.open(f"a.note='{name}'").graph.nodes["a"].parameters["note"] == name


def test_null_is_still_nothing(here: Workspace) -> None:
    here.write("stages:\n  a: {uses: numbers, with: {file: 2024}}\n")
    assert here.open("a.file=null").graph.nodes["a"].arguments["file"] is None
    here.write(FILE % "${folder}")
    assert here.open("folder=null").graph.nodes["a"].arguments["file"] is None


@pytest.mark.parametrize(
    ("value", "said"),
    [("!!int ''", "is neither text"), ("[fox", "not YAML"), ("a #b", "a comment"), (f"0x{'f' * 999}", "1024 bits")],
)
def test_what_cannot_be_read_is_told_once(here: Workspace, value: str, said: str) -> None:
    here.write(FILE % "${folder}/numbers.txt")
    (problem,) = here.problems(f"folder={value}")
    assert said in problem
    here.write("stages:\n  a: {uses: numbers}\n")
    (problem,) = here.problems(f"a.file={value}")
    assert said in problem
