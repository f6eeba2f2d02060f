"""A run says beforehand that the disk may become full, and only if it may."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.plan import room
from pipeline.plan.room import RESULTS, lacking_room
from tests.pipeline.helpers import TOYS, Workspace

WORKFLOW = """
    stages:
      first: {uses: numbers, with: {file: five.txt}}
      again: {uses: scale, in: {numbers: first}}
      second: {uses: numbers, with: {file: five.txt, first: 2}}
    """


@pytest.fixture
def here(workspace: Workspace) -> Workspace:
    (workspace.folder / "five.txt").write_text("5\n" * 500)
    return workspace.write(WORKFLOW)


def call(workspace: Workspace, *arguments: str) -> str:
    store = ["--store", str(workspace.folder / "store")]
    done = CliRunner().invoke(app, ["run", str(workspace.file), "--stages", TOYS, *store, *arguments])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize(("free", "told"), [(RESULTS + 999, True), (RESULTS + 1000, False), (None, False)])
def test_what_is_copied_and_something_more_needs_room(
    here: Workspace, monkeypatch: pytest.MonkeyPatch, free: int | None, told: bool
) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda path: free)
    project = here.open()
    note = lacking_room(project.graph.nodes.values(), project.store)
    expected = "has 1.0 GB free; this run may need 1.0 GB, 1.0 kB of it for copies of photos and other files"
    assert note == (f"the disk that holds {here.folder}/store {expected}" if told else None)


def test_a_folder_counts_with_all_in_it_and_what_its_links_lead_to(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda path: 0)
    monkeypatch.setattr(room, "RESULTS", 0)
    (workspace.folder / "photos/left").mkdir(parents=True)
    (workspace.folder / "elsewhere.jpg").write_bytes(bytes(5000))
    (workspace.folder / "photos/left/1.jpg").write_bytes(bytes(600))
    (workspace.folder / "photos/2.jpg").symlink_to("../elsewhere.jpg")
    project = workspace.write("stages:\n  a: {uses: numbers, with: {file: photos}}\n").open()
    note = lacking_room(project.graph.nodes.values(), project.store)
    assert "has 0 B free; this run may need 5.6 kB" in str(note)


def test_a_run_says_so_once_and_goes_on(here: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda path: 1000)
    assert call(here, "--serial").count("has 1.0 kB free") == 1
    assert "free" not in call(here, "--serial"), "all is in the store"
