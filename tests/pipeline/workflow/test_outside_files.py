"""Files outside the store are read only if the workflow has no other mistake, so gigabytes are not read in vain."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.console.project import open_project
from pipeline.errors import CommandError
from pipeline.store.external_cache import ExternalCache
from tests.pipeline.helpers import TOYS, Workspace

WORKFLOW = """
    vars: {width: 3}
    stages:
      first: {uses: numbers, with: {file: five.txt, count: '${width}'}}
      second: {uses: numbers, with: {file: five.txt}}
      third: {uses: scale, in: {numbers: first}}
    """


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What was read, in order."""
    paths: list[Path] = []
    digest = ExternalCache.digest

    def counted(cache: ExternalCache, path: Path) -> str:
        paths.append(path)
        return digest(cache, path)

    monkeypatch.setattr(ExternalCache, "digest", counted)
    return paths


@pytest.fixture
def here(workspace: Workspace) -> Workspace:
    (workspace.folder / "five.txt").write_text("5\n")
    return workspace.write(WORKFLOW)


def test_each_is_read_once(here: Workspace, read: list[Path]) -> None:
    nodes = here.open().graph.nodes
    assert nodes["first"].external == nodes["second"].external != {}
    assert nodes["third"].external == {}
    assert read == [here.folder / "five.txt"]


@pytest.mark.parametrize("setting", ["widht=3", "width=x", "third.factr=3", "second.file=nowhere.txt", "nonsense"])
def test_nothing_is_read_for_a_workflow_with_a_mistake(here: Workspace, read: list[Path], setting: str) -> None:
    assert here.problems(setting)
    assert read == []


def test_nothing_is_read_for_a_stage_that_is_none(here: Workspace, read: list[Path]) -> None:
    with pytest.raises(CommandError, match=r"no stage 'secnd' in .*did you mean 'second'"):
        open_project(here.file, here.folder / "store", (), TOYS, stages=["secnd"])
    assert read == []


def test_a_mistyped_stage_of_many_rows_is_told_in_a_line(workspace: Workspace) -> None:
    rows = ", ".join(f"{{a: {number}}}" for number in range(100))
    workspace.write(f"""
        vars: {{rows: [{rows}]}}
        stages:
          each: {{foreach: "${{rows}}", uses: numbers, with: {{count: "${{item.a}}"}}}}
        """)
    graph = workspace.open().graph
    with pytest.raises(CommandError, match=r"no stage 'eahc' in .*; there are each; did you mean 'each'") as told:
        graph.needed_for(["eahc"])
    assert len(str(told.value)) < 200
    with pytest.raises(CommandError, match=r"no 'each\[777\]' in .*; there are each\[0\], .* and 92 more"):
        graph.needed_for(["each[777]"])


@pytest.mark.parametrize(
    ("given", "there"), [("phtos", "photos"), ("phtos/fox", "photos/fox"), ("photos/fxo", "photos/fox")]
)
def test_a_folder_of_almost_that_name_is_asked_back(workspace: Workspace, given: str, there: str) -> None:
    (workspace.folder / "photos/fox").mkdir(parents=True)
    workspace.write(f"stages:\n  a: {{uses: numbers, with: {{file: {given}}}}}\n")
    (problem,) = workspace.problems()
    assert problem.endswith(f"{str(workspace.folder / given)!r}; did you mean {str(workspace.folder / there)!r}?")


@pytest.mark.parametrize("given", ["phtos/wolf", "elsewhere/fox", "photos/fox/1.jpg"])
def test_nothing_is_asked_back_that_leads_nowhere(workspace: Workspace, given: str) -> None:
    (workspace.folder / "photos/fox").mkdir(parents=True)
    workspace.write(f"stages:\n  a: {{uses: numbers, with: {{file: {given}}}}}\n")
    (problem,) = workspace.problems()
    assert "did you mean" not in problem
