"""What a person may not expect of a run is said before hours go into it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.plan.foretelling import foretold
from tests.pipeline.helpers import TOYS, Workspace
from tests.pipeline.model import StageNode
from tests.pipeline.test_never_stale import Session, forget

DRAWN = """
    name: drawn
    stages:
      base: {uses: numbers}
      key:  {uses: draw, in: {of: [base]}}
    """
WAITS = "key: made anew if the inputs turn out different; a new one cannot read what was made or published with"
ANEW = "key is made anew because what it depends on has changed; a new one cannot read what was made or published"


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    nodes = [
        StageNode("s0", "source", [], {}),
        StageNode("s1", "transform", [0], {}),
        StageNode("s2", "merge", [0], {}),
    ]
    with Session(tmp_path, nodes, []) as session:
        session.world.write()
        yield session


def run(workspace: Workspace, *arguments: str) -> tuple[str, str]:
    """What a run prints for programs, and what it prints beside that."""
    where = ["--store", str(workspace.folder / "store"), "--stages", workspace.package, "--serial", "--json"]
    done = CliRunner().invoke(app, ["run", str(workspace.file), *where, *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout, done.stderr


def test_what_is_done_again_for_its_code_alone(session: Session) -> None:
    """Only before they are made again can the earlier results be kept."""
    assert run(session.workspace)[1] == ""
    for name in ("transform", "merge"):
        session.world.code[name].unused += 1
    session.world.write()
    forget(session.world.package)
    told = run(session.workspace)[1]
    assert told.startswith(
        "running again although only code changed: s1, s2; to keep the earlier results, stop this run and `acc"
    )
    assert run(session.workspace)[1] == "", "nothing is done"


def test_many_names_are_cut(session: Session) -> None:
    text = "stages:\n  s: {foreach: {base: [1, 2, 3, 4, 5, 6]}, uses: source, with: {base: '${item.base}'}}\n"
    session.workspace.write(text).run()
    session.world.code["source"].unused += 1
    session.world.write()
    session.workspace.write(text)
    forget(session.world.package)
    (told,) = foretold(session.workspace.open().graph, session.workspace.plan())
    assert told.startswith("running again although only code changed: s[1], s[2], s[3], s[4] and 2 more; ")


def test_another_that_is_the_only_one_of_its_kind(workspace: Workspace) -> None:
    """With a new key, one's own published work is no longer recognised, so its owner must know why there is one."""
    assert workspace.package == TOYS
    workspace.write(DRAWN)
    assert run(workspace)[1] == ""
    waits, anew = run(workspace, "--set", "base.first=3")[1].splitlines()
    assert (waits.startswith(WAITS), anew.startswith(ANEW)) == (True, True)
    for settings in ((), ("--set", "base.first=3")):
        assert run(workspace, *settings)[1] == "", "it is there"
    assert run(workspace, "--set", "base.note=new")[1].startswith(WAITS)
    assert ANEW not in run(workspace, "--set", "base.note=newer")[1], "the same came out, so the same key is there"
    assert run(workspace, "--set", "base.first=4", "--set", "key.seed=1")[1] == "", "anybody can draw it again"


@pytest.mark.parametrize("level", [0, 1])
def test_another_that_no_stage_reads_concerns_nobody(workspace: Workspace, level: int) -> None:
    """Nothing was made with such a key, so nothing is lost with it."""
    workspace.write(f"{DRAWN}  mark: {{uses: mark, in: {{numbers: base, key: key}}, with: {{level: {level}}}}}\n")
    assert run(workspace)[1] == ""
    told = run(workspace, "--set", "base.first=3")[1].splitlines()
    assert [line.startswith(words) for line, words in zip(told, (WAITS, ANEW), strict=False)] == [True, True] * level


def test_another_that_one_of_two_stages_reads(workspace: Workspace) -> None:
    workspace.write(
        f"""{DRAWN}
      mark: {{uses: mark, in: {{numbers: base, key: key}}, with: {{level: 0}}}}
      hide: {{uses: scale, in: {{numbers: key}}}}
    """
    )
    assert run(workspace)[1] == ""
    waits, anew = run(workspace, "--set", "base.first=3")[1].splitlines()
    assert (waits.startswith(WAITS), anew.startswith(ANEW)) == (True, True)
    assert run(workspace, "key", "--set", "base.first=4")[1].count("key") >= 2, "no stage takes it: a person may"
