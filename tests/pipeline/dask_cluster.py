"""A dask scheduler and workers as separate processes on loopback, as a cluster has them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from distributed import Client

ROOT = Path(__file__).parents[2]


class Cluster:
    """Started in `folder`, where the processes also write their logs; killed at the end of the `with` block."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "scheduler.json"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.scheduler = self._start(
            "scheduler", ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"], ROOT
        )
        try:
            wait_until(lambda: self.file.is_file() and self.file.read_text().endswith("}"), "the scheduler is there")
            self.address: str = json.loads(self.file.read_text())["address"]
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self.processes.values():
            process.kill()
            process.wait()

    def worker(self, name: str, resources: str = "", sources: Path = ROOT) -> subprocess.Popen[bytes]:
        """Starts a worker without a nanny, which runs the code in the folder `sources`."""
        stated = ["--resources", resources] if resources else []
        options = ["--name", name, "--nthreads", "1", "--memory-limit", "0", "--no-nanny"]
        return self._start(name, ["worker", *options, "--no-dashboard", "--host", "127.0.0.1", *stated], sources)

    def await_workers(self, number: int) -> None:
        """Returns when this many workers have joined."""
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(number, timeout=60)

    def _start(self, name: str, command: list[str], sources: Path) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--scheduler-file", str(self.file)],
                cwd=self.folder,
                env=os.environ | {"PYTHONPATH": str(sources)},
                stdout=log,
                stderr=log,
            )
        self.processes[name] = process
        return process


def wait_until(happened: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
    """Returns when it has happened; fails after a time far longer than it can take."""
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, f"waited for: {what}"
        time.sleep(0.02)
