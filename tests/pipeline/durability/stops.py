"""Stops a run at each of its steps in turn, just before it changes something in its store.

    python -m tests.pipeline.durability.stops FOLDER kill|full|broken|denied commit|run

Python tells an audit hook of every file that is opened, folder made, renaming and removal. At the n-th of these, the
hook kills the process with SIGKILL (`kill`), or makes it fail: from the n-th on for lack of space (`full`), or once
with an error of the disk (`broken`) or for lack of permission (`denied`). It only fails what makes something, not
removals. This is done for every n, each time in a child of this process, forked before any thread is started, on a copy
of a store in which part of the work is done. Then the work is done again, undisturbed. Prints one JSON object a line:
the steps, and what came of them.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import distributed  # noqa: F401 — loaded once, here, and not in every child
import zarr  # noqa: F401

from pipeline import cli
from pipeline.store.store import Store
from tests.pipeline.durability.commands import check_whole, finished
from tests.pipeline.helpers import Workspace

TOYS = "tests.pipeline.toys"
WORKFLOW = """
    name: stops
    stages:
      base: {uses: numbers}
      sum:  {uses: total, in: {numbers: base}, private: true}
    """
ERRORS = {"full": errno.ENOSPC, "broken": errno.EIO, "denied": errno.EACCES}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
MAKING = {"open", "os.mkdir", "os.symlink", "os.rename"}


class Stopper:
    """The audit hook; it counts steps while it is `armed`."""

    def __init__(self, store: Path, number: int, how: str) -> None:
        self.store = str(store)
        self.number = number
        self.how = how
        self.armed = False
        self.steps: list[str] = []

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.armed or not self.changes(event, arguments):
            return
        path = str(arguments[0]).replace(self.store, "")
        if self.how == "kill":
            self.count(event, path)
            if len(self.steps) == self.number:
                os.kill(os.getpid(), signal.SIGKILL)
        elif event in MAKING:
            self.count(event, path)
            if len(self.steps) == self.number or (self.how == "full" and len(self.steps) > self.number):
                raise OSError(ERRORS[self.how], os.strerror(ERRORS[self.how]), str(arguments[0]))

    def count(self, event: str, path: str) -> None:
        self.steps.append(f"{event} {path}")

    def changes(self, event: str, arguments: tuple[Any, ...]) -> bool:
        if event == "open":
            return str(arguments[0]).startswith(self.store) and bool((arguments[2] or 0) & WRITING)
        if event in ("os.mkdir", "os.rename", "os.chmod"):
            return str(arguments[0]).startswith(self.store)
        if event == "os.symlink":
            return str(arguments[1]).startswith(self.store)
        return event in ("os.remove", "os.rmdir")  # when a tree is removed, these are relative to its folders


def in_child(work: Callable[[], int]) -> int:
    """The exit status of `work` in a child process, or minus the number of the signal that killed it."""
    child = os.fork()
    if child == 0:
        status = 99
        try:
            status = work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def run(workspace: Workspace, stopper: Stopper | None, only_commits: bool) -> int:
    """Runs the command line in this process; its output goes to a file."""
    descriptor = os.open(workspace.folder / "printed.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    if stopper:
        sys.addaudithook(stopper)
        if only_commits:
            arm_in_commits(stopper)
        else:
            stopper.armed = True
    store = str(workspace.folder / "store")
    sys.argv = ["pipeline", "run", str(workspace.file), "--stages", TOYS, "--store", store, "--serial"]
    try:
        cli.main()
    except SystemExit as end:
        status = end.code
    if stopper:
        stopper.armed = False
        (workspace.folder / "steps.json").write_text(json.dumps(stopper.steps))
    return int(status or 0)


def arm_in_commits(stopper: Stopper) -> None:
    """Makes steps count from the commit of the stage to the end of the run."""
    commit = Store.commit

    def armed(*arguments: Any) -> Any:
        stopper.armed = True
        return commit(*arguments)

    Store.commit = armed  # type: ignore[method-assign]


def begin(folder: Path, template: Path | None) -> Workspace:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    workspace = Workspace(folder, TOYS).write(WORKFLOW)
    if template:
        shutil.copytree(template / "store", folder / "store", symlinks=True)
    return workspace


def try_step(folder: Path, template: Path, number: int, how: str, only_commits: bool) -> dict[str, Any]:
    """Stops at one step; returns what happened then, and in the run after it."""
    workspace = begin(folder, template)
    (workspace.folder / "store/latest").mkdir(exist_ok=True)
    store = Store(folder / "store")
    before = finished(store)
    stopper = Stopper(store.root, number, how)
    status = in_child(lambda: run(workspace, stopper, only_commits))
    printed = (folder / "printed.txt").read_text()
    between = finished(store)
    again = in_child(lambda: run(workspace, None, only_commits=False))
    check_whole(store)
    steps = folder / "steps.json"
    return {
        "step": json.loads(steps.read_text()) if steps.exists() else None,
        "status": status,
        "printed": printed,
        "kept": before.items() <= between.items() and between.items() <= finished(store).items(),
        "again": again,
        "objects": sorted(store.objects),
    }


def main() -> None:
    folder, how, where = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    os.environ["POCL_CACHE_DIR"] = str(folder / "kernels")
    template = begin(folder / "template", None)
    half = lambda: run_only_base(template)  # noqa: E731 — a child's work
    assert in_child(half) == 0
    number = 0
    while True:
        number += 1
        result = try_step(folder / "work", folder / "template", number, how, where == "commit")
        print(json.dumps({"number": number, **result}), flush=True)
        if result["status"] == 0 and result["step"] is not None and len(result["step"]) < number:
            break  # there was no such step


def run_only_base(workspace: Workspace) -> int:
    workspace.run(stages=["base"])
    return 0


if __name__ == "__main__":
    main()
