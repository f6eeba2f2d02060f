"""Looking makes no store: a command that only reads answers as for an empty store and leaves nothing behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.store.opening import open_store
from tests.pipeline.helpers import CHAIN, TOYS, Workspace

ABSENT = "The store is store, which does not exist yet"


@pytest.fixture
def here(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    """A current folder with a workflow that takes a file and has never run."""
    monkeypatch.delenv("GS_HIDER_STORE", raising=False)
    monkeypatch.chdir(workspace.folder)
    (workspace.folder / "five.txt").write_text("5\n")
    return workspace.write(CHAIN.rstrip() + "\n      read: {uses: numbers, with: {file: five.txt}}\n")


def call(command: str, *arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, [command, "workflow.yaml", *arguments, "--stages", TOYS])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*"))


@pytest.mark.parametrize("empty", [False, True])
@pytest.mark.parametrize(
    ("command", "arguments", "status", "said"),
    [
        ("status", (), 0, ABSENT),
        ("run", ("--dry-run",), 0, ABSENT),
        ("run", ("twice", "--dry-run"), 0, ABSENT),
        ("status", ("--json",), 0, "it has never run"),
        ("explain", ("twice",), 0, "it has never run"),
        ("graph", (), 0, "total"),
        ("accept", ("twice", "--dry-run"), 2, "it has no complete result in the store"),
        ("accept", ("twice",), 2, "it has no complete result in the store"),
        ("pin", (), 2, "some of these results are not in the store"),
    ],
)
def test_a_store_that_is_not_there_is_not_made(
    here: Workspace, command: str, arguments: tuple[str, ...], status: int, said: str, empty: bool
) -> None:
    if empty:
        (here.folder / "store").mkdir()
    before = files(here.folder)
    code, output = call(command, *arguments)
    assert (code, said in output) == (status, True), output
    assert files(here.folder) == before


def test_a_workflow_that_is_not_there_makes_no_store(here: Workspace) -> None:
    (here.folder / "workflow.yaml").unlink()
    before = files(here.folder)
    code, output = call("run")
    assert (code, "cannot read the workflow" in output) == (2, True)
    assert files(here.folder) == before


@pytest.mark.parametrize("text", ["stages: [", "stages: {one: {with: {factor: ${none}}}}", ""])
def test_a_workflow_that_cannot_be_read_makes_no_store(here: Workspace, text: str) -> None:
    (here.folder / "workflow.yaml").write_text(text)
    before = files(here.folder)
    code, output = call("run")
    assert (code, "workflow.yaml" in output) == (2, True), output
    assert files(here.folder) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("--set", "read.file=six.txt"),
        ("--set", "twice.factor=two"),
        ("--set", "twice.factr=2"),
        ("--set", "width=2"),
        ("trice",),
        ("--vars", "profile.yaml"),
    ],
)
def test_a_mistake_makes_no_store(here: Workspace, arguments: tuple[str, ...]) -> None:
    """Least of all in a wrong folder, where nobody would look for it."""
    before = files(here.folder)
    code, output = call("run", *arguments)
    assert code == 2, output
    assert files(here.folder) == before


def test_the_first_run_remembers_what_it_learnt(here: Workspace) -> None:
    """The store is made after planning. What planning learnt is stored all the same, and later shows what changed."""
    assert call("run", "--serial")[0] == 0
    left = {path.name for path in (here.folder / "store/cache").iterdir()}
    assert {"declarations", "sources"} <= left
    assert all(list((here.folder / "store" / name).glob("*.json")) for name in ("code", "external"))


def test_a_picture_of_the_graph_is_all_that_is_made(here: Workspace) -> None:
    before = files(here.folder)
    assert call("graph", "--svg", "graph.svg")[0] == 0
    assert files(here.folder) == sorted([*before, here.folder / "graph.svg"])


def test_the_store_that_was_read_is_named(here: Workspace) -> None:
    here.run()
    for arguments in (("status",), ("run", "--dry-run")):
        assert call(*arguments)[1].splitlines()[-1] == "The store is store"
    assert [json.loads(line)["state"] for line in call("status", "--json")[1].splitlines()] == ["cached"] * 5
    assert call("status", "--store", "elsewhere")[1].splitlines()[-1] == (
        "The store is elsewhere, which does not exist yet"
    )


def test_a_store_in_the_home_folder_is_found(here: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shell does not expand the ~ of `--store=~/store`."""
    monkeypatch.setenv("HOME", str(here.folder))
    here.run()
    assert "5 cached" in call("status", "--store=~/store")[1]
    result = CliRunner().invoke(app, ["verify", "--store=~/store"])
    assert result.output.startswith("Everything is sound")


def test_what_can_be_no_store_is_refused_all_the_same(here: Workspace) -> None:
    code, output = call("status", "--store", "five.txt")
    assert (code, "five.txt: cannot be used as a store" in output) == (2, True)
    assert "Name a folder that you can write to, with --store or $GS_HIDER_STORE." in output


def test_a_bucket_whose_address_lacks_a_slash_is_no_folder(here: Workspace) -> None:
    """Otherwise results, secrets included, would go to a folder named `s3:` in the current folder."""
    code, output = call("run", "--store", "s3:/bucket/results")
    assert (code, "not a bucket address; found s3:/bucket/results" in output) == (2, True)
    assert not Path("s3:").exists()


def test_it_is_empty_and_cannot_be_written(tmp_path: Path) -> None:
    store = open_store(tmp_path / "nowhere", make=False)
    assert (store.actions, store.objects, store.history.workflows(), store.pins.names) == (set(), set(), [], [])
    with store.in_use(alone=True), pytest.raises(OSError, match="no store there yet"):
        store.temporary()
    assert not store.root.exists()
