"""Two runs of one workflow write the same logs and links, so the second says that there is another."""

from __future__ import annotations

from contextlib import ExitStack

from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.store.other_runs import beside_others
from pipeline.store.store import Store
from tests.pipeline.helpers import TOYS, Workspace

TOLD = "another run of single is in progress"


def told(workspace: Workspace) -> bool:
    where = ["--store", str(workspace.folder / "store"), "--stages", TOYS, "--serial"]
    done = CliRunner().invoke(app, ["run", str(workspace.file), *where])
    assert done.exit_code == 0, done.output
    return TOLD in done.stderr


def test_a_second_run_is_told_of_the_first(workspace: Workspace) -> None:
    workspace.write("name: single\nstages:\n  a: {uses: numbers}\n")
    assert not told(workspace)
    store = Store(workspace.folder / "store")
    with beside_others(store, "single") as others:
        assert not others
        assert told(workspace)
    assert not told(workspace)
    with beside_others(store, "another"):
        assert not told(workspace)


def test_each_is_seen_until_it_ends(workspace: Workspace) -> None:
    store = Store(workspace.folder / "store")
    with ExitStack() as first:
        assert not first.enter_context(beside_others(store, "single"))
        with beside_others(store, "single") as others:
            assert others
            first.close()
            with beside_others(store, "single") as others:
                assert others, "the second is still at it"


def test_where_it_cannot_be_seen_nothing_fails(workspace: Workspace) -> None:
    """As on a full disk, or if something else has that name."""
    store = Store(workspace.folder / "store")
    (store.folder("locks") / "runs").touch()
    with beside_others(store, "single") as others:
        assert not others
