"""Runs on a disk that is too small, in a namespace of its own, where anyone may mount one.

    unshare -Urm python -m tests.pipeline.durability.small_disk FOLDER --serial|--workers=N

Prints one JSON object a line: a name, the exit status, and what was printed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from pipeline.store.store import Store
from tests.pipeline.durability import commands
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import Workspace

WORKFLOW = """
    name: disk
    stages:
      small: {uses: grow, with: {steps: 2, size: 1000, seed: 1}}
      large: {uses: grow, with: {steps: 2, size: 60000, seed: 2}}
      loud:  {uses: shout, with: {lines: 1500}}
    """
ROOM = "60m"


def mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True)


class Disk:
    """A workspace whose store is a disk of its own."""

    def __init__(self, folder: Path, size: str) -> None:
        folder.mkdir()
        self.workspace = Workspace(folder, TOYS).write(WORKFLOW)
        self.store = folder / "store"
        self.store.mkdir()
        mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(self.store))

    def resize(self, size: str) -> None:
        mount("-o", f"remount,size={size}", str(self.store))

    def fill(self) -> Path:
        """Takes up all remaining space."""
        ballast = self.store / "ballast"
        with ballast.open("wb", buffering=0) as file:
            for size in (1 << 16, 4096, 1):
                try:
                    while True:
                        file.write(b"x" * size)
                except OSError:
                    pass
        return ballast

    def call(self, name: str, *arguments: str, command: str = "run") -> None:
        flags = [sys.argv[2]] if command == "run" else []
        status, printed = commands.call(self.workspace, *arguments, *flags, command=command)
        print(json.dumps({"name": name, "status": status, "printed": printed}), flush=True)

    def call_on_store(self, name: str, *words: str) -> None:
        """Runs a command that takes no workflow."""
        command = [sys.executable, "-m", "pipeline", *words, "--store", str(self.store)]
        done = subprocess.run(command, cwd=commands.ROOT, capture_output=True, text=True)
        print(json.dumps({"name": name, "status": done.returncode, "printed": done.stdout + done.stderr}), flush=True)

    def check(self) -> None:
        commands.check_whole(Store(self.store))


def large_result(folder: Path) -> None:
    """The disk is full while an artifact or a checkpoint is written."""
    disk = Disk(folder, "1800k")
    disk.call("large: full", "small", "large")
    kept = commands.finished(Store(disk.store))
    assert kept, "small was finished"
    disk.resize(ROOM)
    disk.call("large: room", "small", "large")
    assert kept.items() <= commands.finished(Store(disk.store)).items()
    disk.check()


def full_checkpoint(folder: Path) -> None:
    disk = Disk(folder, "1m")
    disk.call("checkpoint: full", "large")
    disk.resize(ROOM)
    disk.call("checkpoint: room", "large")
    disk.check()


def full_log(folder: Path) -> None:
    disk = Disk(folder, "1m")
    disk.call("log: full", "loud")
    disk.resize(ROOM)
    disk.call("log: room", "loud")
    disk.check()


def full_before(folder: Path) -> None:
    """Without a byte free, finished work can still be used, and a run fails with a message."""
    disk = Disk(folder, ROOM)
    disk.call("before: room", "small")
    disk.resize("8m")
    ballast = disk.fill()
    disk.call("before: cached", "small")
    disk.call("before: full", "small", "large")
    for command in ("status", "graph"):
        disk.call(f"before: {command}", command=command)
    ballast.unlink()
    disk.call("before: room again", "small", "large")
    disk.check()


def read_only(folder: Path) -> None:
    disk = Disk(folder, ROOM)
    disk.call("read-only: before", "small")
    disk.call("read-only: pinned before", "small", command="pin")
    mount("-o", "remount,ro", str(disk.store))
    for command, arguments in (("status", ()), ("graph", ()), ("explain", ("large",)), ("run", ("--dry-run",))):
        disk.call(f"read-only: {command}", *arguments, command=command)
    disk.call("read-only: plan with new parameters", "--set", "large.seed=9", command="status")
    disk.call("read-only: to run")
    disk.call("read-only: to take", "small")
    disk.call("read-only: to pin", "small", "--name", "other", command="pin")
    for words in (("gc",), ("unpin", "disk.small")):
        disk.call_on_store(f"read-only: to {words[0]}", *words)
    disk.call_on_store("read-only: verify", "verify")
    mount("-o", "remount,rw", str(disk.store))
    next(disk.store.glob("objects/*/manifest.json")).write_text("{")
    mount("-o", "remount,ro", str(disk.store))
    disk.call_on_store("read-only: damaged", "verify")


def main() -> None:
    folder = Path(sys.argv[1])
    large_result(folder / "large")
    full_checkpoint(folder / "checkpoint")
    full_log(folder / "log")
    full_before(folder / "before")
    read_only(folder / "read-only")


if __name__ == "__main__":
    main()
