"""Ctrl-C once and twice, SIGTERM to all processes, as cluster schedulers send it, and a terminal that is closed."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from pipeline.store.store import Store
from tests.pipeline.durability import commands
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import Workspace

WORKFLOW = """
    name: signals
    stages:
      long:  {uses: grow, with: {steps: 150, size: 10, pause: 0.02}}
      after: {uses: gather, in: {numbers: long}}
    """


def steps(workspace: Workspace) -> list[int]:
    return [int(line[2]) for line in commands.lines_told(workspace) if line[0] == "step"]


def begun(folder: Path, flags: list[str]) -> tuple[Workspace, commands.Running]:
    """A run that has made a few steps."""
    workspace = Workspace(folder, TOYS).write(WORKFLOW)
    process = commands.start(workspace, *flags)
    commands.await_that(lambda: len(steps(workspace)) >= 3 or process.poll() is not None, "steps")
    return workspace, process


def check_interrupted(workspace: Workspace, process: commands.Running) -> None:
    everyone = commands.descendants(process.pid)
    assert process.wait(commands.LONGEST) == 130
    commands.await_that(lambda: not any(map(commands.is_alive, everyone)), "workers to end")
    printed = (workspace.folder / "printed.txt").read_text()
    assert "Traceback" not in printed, printed
    assert f"To continue: {sys.executable} -m pipeline run {workspace.file}" in printed
    assert len(steps(workspace)) < 150
    (checkpoint,) = workspace.folder.glob("store/scratch/*/checkpoint.npz")
    assert checkpoint.stat().st_size


def check_goes_on(workspace: Workspace) -> None:
    """From the last checkpoint: no step is repeated."""
    status, printed = commands.call(workspace, "--serial")
    assert status == 0, printed
    made = steps(workspace)
    assert made == sorted(set(made)), "steps were repeated"
    commands.check_whole(Store(workspace.folder / "store"))


@pytest.mark.parametrize(
    ("number", "flags"),
    [
        pytest.param(signal.SIGINT, ["--serial"], marks=pytest.mark.slow),
        (signal.SIGTERM, ["--workers", "1"]),
        pytest.param(signal.SIGHUP, ["--serial"], marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, ["--workers", "2"], marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, ["--workers", "1"], marks=pytest.mark.slow),
    ],
)
def test_asked_to_stop(tmp_path: Path, number: signal.Signals, flags: list[str]) -> None:
    """The signal goes to the whole group, workers included, and the engine decides."""
    workspace, process = begun(tmp_path, flags)
    os.killpg(process.pid, number)
    check_interrupted(workspace, process)
    check_goes_on(workspace)


@pytest.mark.parametrize("flags", [pytest.param(["--serial"], marks=pytest.mark.slow), ["--workers", "1"]])
def test_ctrl_c_twice(tmp_path: Path, flags: list[str]) -> None:
    """Stops at once, even if the stage is deep in a library and does not see that it should stop."""
    workspace = Workspace(tmp_path, TOYS).write("stages:\n  a: {uses: crash, with: {how: library}}\n")
    if flags == ["--serial"]:
        workspace.write(WORKFLOW)
    process = commands.start(workspace, *flags)
    commands.await_that(lambda: commands.lines_told(workspace), "the stage")
    everyone = commands.descendants(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    commands.await_that(
        lambda: "stopping" in (tmp_path / "printed.txt").read_text() or process.poll() is not None, "the first"
    )
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(commands.LONGEST) == 130
    commands.await_that(lambda: not any(map(commands.is_alive, everyone)), "workers to end")
    printed = (tmp_path / "printed.txt").read_text()
    assert "Traceback" not in printed, printed
    assert f"To continue: {sys.executable} -m pipeline run" in printed
