"""Runs the command line in a process of its own, and looks at what it left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from pipeline.store.store import Store
from tests.pipeline.helpers import Workspace

ROOT = Path(__file__).parents[3]
TOYS = "tests.pipeline.durability.toys"
LONGEST = 600  # seconds; no test needs as many, and none may hang

Running = subprocess.Popen[str]


def start(workspace: Workspace, *arguments: str, command: str = "run", store: str = "store") -> Running:
    """Starts a command in a session of its own. Its output goes to a file, so that nothing blocks on a pipe."""
    environment = {**os.environ, "TOLD": str(told(workspace)), "POCL_CACHE_DIR": str(workspace.folder / "kernels")}
    options = ["--stages", workspace.package, "--store", str(workspace.folder / store)]
    printed = workspace.folder / "printed.txt"
    with printed.open("a") as file:
        return subprocess.Popen(
            [sys.executable, "-m", "pipeline", command, str(workspace.file), *options, *arguments],
            cwd=ROOT,
            env=environment,
            stdout=file,
            stderr=file,
            text=True,
            start_new_session=True,
        )


def call(workspace: Workspace, *arguments: str, command: str = "run", store: str = "store") -> tuple[int, str]:
    """The exit status of this command, and what it printed."""
    printed = workspace.folder / "printed.txt"
    printed.unlink(missing_ok=True)
    status = start(workspace, *arguments, command=command, store=store).wait(LONGEST)
    return status, printed.read_text()


def told(workspace: Workspace) -> Path:
    return workspace.folder / "told.txt"


def lines_told(workspace: Workspace) -> list[list[str]]:
    path = told(workspace)
    return [line.split(" ") for line in path.read_text().splitlines()] if path.exists() else []


def await_that(holds: Callable[[], object], what: str) -> None:
    """Waits for another process to do something."""
    deadline = time.monotonic() + LONGEST
    while not holds():
        assert time.monotonic() < deadline, f"waited for {what}"
        time.sleep(0.01)


def descendants(process: int) -> set[int]:
    """The descendants of `process`, without itself."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    found: set[int] = set()
    waiting = {process}
    while waiting:
        waiting = {child for child, parent in parents.items() if parent in waiting} - found
        found |= waiting
    return found


def workers_of(process: int) -> list[int]:
    """dask's workers among the descendants of a run."""
    found = []
    for child in sorted(descendants(process)):
        with suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(child)
    return found


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill(process: int, group: bool = False) -> None:
    with suppress(ProcessLookupError):
        (os.killpg if group else os.kill)(process, signal.SIGKILL)


def finished(store: Store) -> dict[str, tuple[int, int]]:
    """Inode and modification time of every file of finished work."""
    files = [path for folder in ("actions", "objects") for path in (store.root / folder).rglob("*") if path.is_file()]
    return {str(path.relative_to(store.root)): (path.stat().st_ino, path.stat().st_mtime_ns) for path in files}


def check_whole(store: Store) -> None:
    """Every action has its results, every byte of them as it was written, and nothing else is left behind."""
    for key in store.actions:
        record = store.find(key)
        assert record is not None, key
        for digest in record.outputs.values():
            store.artifact(digest).verify()
    assert not list(store.root.glob("scratch/*")), "checkpoints of finished actions"
    assert not list(store.root.glob("temporary/*/*")), "what killed processes were writing"
