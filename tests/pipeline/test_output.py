"""A terminal, or whoever reads a pipe, that goes away during a run: the run goes on, and ends as it would have."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest

from pipeline import cli
from pipeline.events import Noted, StageEnded, StageStarted
from pipeline.livetable import LiveTable
from pipeline.output import lossy_output
from pipeline.progress import make_display
from tests.pipeline.helpers import TOYS, Workspace


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, TextIO]]:
    """A pipe into which this process prints, as `|& tee` has it, and the end that is read."""
    read, write = os.pipe()
    with os.fdopen(write, "w", buffering=1) as printed:
        monkeypatch.setattr(sys, "stdout", printed)
        monkeypatch.setattr(sys, "stderr", printed)
        yield read, printed


def run(workspace: Workspace, *flags: str) -> object:
    """The exit status of `run` in this process, where it is another than 0."""
    store = str(workspace.folder / "store")
    arguments = ["run", str(workspace.file), "--stages", TOYS, "--store", store, "--serial", *flags]
    return cli.app(arguments, standalone_mode=False)


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_nobody_reads(workspace: Workspace, pipe: tuple[int, TextIO], flags: list[str]) -> None:
    os.close(pipe[0])
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: fail, in: {numbers: a}, with: {how: user}}\n")
    assert run(workspace, *flags) == 1
    assert workspace.plan()["a"].state == "cached"
    pipe[1].flush()  # as Python does when it exits, which would change the exit status


def test_the_reader_of_a_pipe_dies_of_ctrl_c_first(
    workspace: Workspace, pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stage saves its checkpoint all the same, and the run ends as one that was interrupted."""
    monkeypatch.setattr(signal, "getsignal", lambda number: signal.SIG_DFL)  # whoever runs the tests may ignore it
    workspace.write("stages:\n  a: {uses: wait}\n")

    def tee() -> None:
        with os.fdopen(pipe[0]) as lines:
            next(line for line in lines if line.startswith("a: started"))
        os.kill(os.getpid(), signal.SIGINT)

    reader = threading.Thread(target=tee)
    reader.start()
    assert run(workspace) == 130
    reader.join()
    (checkpoint,) = workspace.folder.glob("store/scratch/*/checkpoint")
    assert checkpoint.read_text() == "half"


def test_a_terminal_is_closed_below_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, screen = os.openpty()
    with os.fdopen(screen, "w", buffering=1) as printed:
        monkeypatch.setattr(sys, "stderr", printed)
        with lossy_output(), make_display("w", 2, json=False) as display:
            assert isinstance(display, LiveTable)
            display(StageStarted("a"))
            os.close(keyboard)
            display(Noted("nobody sees this"))
            display(StageEnded("a", "ran", "5e", 1.0, {}))
            display(StageEnded("b", "failed", "5e", 1.0, {}, "no pictures", tmp_path / "b.log"))


def test_what_can_be_printed_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with lossy_output():
        print("to whom it may concern")
        print("and to others", file=sys.stderr)
    assert capsys.readouterr() == ("to whom it may concern\n", "and to others\n")
