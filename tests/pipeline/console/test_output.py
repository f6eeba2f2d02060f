"""A terminal or a pipe's reader goes away during a run: the run goes on, and ends as it would have."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import pytest

from pipeline import cli
from pipeline.console.live_table import LiveTable
from pipeline.console.output import lossy_output
from pipeline.console.progress import make_display
from pipeline.events import Noted, StageEnded, StageStarted
from tests.pipeline.dask_cluster import ROOT
from tests.pipeline.helpers import TOYS, Workspace


@contextmanager
def printed_into_a_pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, TextIO]]:
    """Makes this process print into a pipe, as `|& tee` does; yields the end to read from and the other."""
    read, write = os.pipe()
    printed = os.fdopen(write, "w", buffering=1)
    with monkeypatch.context() as patch:  # not in a fixture: pytest redirects both streams again when it calls the test
        patch.setattr(sys, "stdout", printed)
        patch.setattr(sys, "stderr", printed)
        yield read, printed
    with suppress(OSError):
        printed.close()


def run(workspace: Workspace, *flags: str) -> object:
    """Calls `run` in this process; returns its exit status if that is not 0."""
    store = str(workspace.folder / "store")
    arguments = ["run", str(workspace.file), "--stages", TOYS, "--store", store, "--serial", *flags]
    return cli.app(arguments, standalone_mode=False)


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_nobody_reads(workspace: Workspace, monkeypatch: pytest.MonkeyPatch, flags: list[str]) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: fail, in: {numbers: a}, with: {how: user}}\n")
    with printed_into_a_pipe(monkeypatch) as (read, printed):
        os.close(read)
        assert run(workspace, *flags) == 1
        printed.flush()  # as Python does at exit: an error there would change the exit status
    plan = workspace.plan()
    assert plan["a"].state == "cached"
    assert plan["b"].failed, "the run went on after the end of the first stage"


def test_the_reader_of_a_pipe_dies_of_ctrl_c_first(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stage still saves its checkpoint, and the run ends as an interrupted one."""
    workspace.write("stages:\n  a: {uses: wait}\n")

    def tee(read: int) -> None:
        with os.fdopen(read) as lines:
            started = any(line.startswith("a: started") for line in lines)
        if started:
            os.kill(os.getpid(), signal.SIGINT)

    with printed_into_a_pipe(monkeypatch) as (read, _):
        reader = threading.Thread(target=tee, args=[read])
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


@pytest.mark.parametrize(("encoding", "folder"), [("latin-1", "store"), ("utf-8:strict", "st\udce9re")])
def test_what_cannot_be_printed_is_spelled(workspace: Workspace, encoding: str, folder: str) -> None:
    """An arrow in Latin-1, and a folder whose name is not UTF-8."""
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a}}\n")
    for command in (["graph"], ["run", "--serial"], ["status"]):
        arguments = [*command, str(workspace.file), "--stages", TOYS, "--store", str(workspace.folder / folder)]
        done = subprocess.run(
            [sys.executable, "-m", "pipeline", *arguments],
            cwd=ROOT,
            env={**os.environ, "PYTHONIOENCODING": encoding},
            capture_output=True,
            check=False,
        )
        assert (done.returncode, b"Traceback" in done.stderr) == (0, False)


@pytest.mark.parametrize("closed", [1, 2])
def test_a_stream_that_was_closed_before(workspace: Workspace, closed: int) -> None:
    """With `>&-` or `2>&-`, the exit status is 0 as ever, and the stage makes its result."""
    workspace.write("stages:\n  a: {uses: say, with: {word: nothing}}\n")
    arguments = ["--stages", TOYS, "--store", str(workspace.folder / "store"), "--serial"]
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "run", str(workspace.file), *arguments],
        cwd=ROOT,
        preexec_fn=lambda: os.close(closed),
        stdout=None if closed == 1 else subprocess.DEVNULL,
        stderr=None if closed == 2 else subprocess.DEVNULL,
        check=False,
    )
    assert done.returncode == 0
    assert workspace.plan()["a"].state == "cached"


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", ["stages", "graph"])  # more than Python keeps back, and less
def test_standard_output_that_cannot_be_written_is_not_the_disk_of_the_store(
    workspace: Workspace, command: str, unbuffered: str
) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n")
    arguments = [] if command == "stages" else [str(workspace.file), "--stages", TOYS]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "pipeline", command, *arguments],
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    words = "standard output cannot be written: No space left on device\n"
    assert (done.returncode, done.stderr) == (1, words)
