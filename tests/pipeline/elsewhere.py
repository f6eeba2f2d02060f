"""Machines that share a bucket, in tests: the server of the bucket, and workspaces whose store is in it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import pytest
import s3fs

from pipeline.console.project import Project, open_project
from pipeline.store.bucket.remote import RemoteStore
from pipeline.store.opening import open_store
from tests.pipeline.helpers import TOYS, Workspace

ROOT = Path(__file__).parents[2]
SECRET = "topsecret"


@dataclass
class Server:
    """The server, and the folder through which tests make it fail."""

    folder: Path
    port: int

    @property
    def requests(self) -> list[str]:
        """Method and path of every request since this was last read."""
        file = self.folder / "requests"
        lines = file.read_text().splitlines() if file.exists() else []
        file.unlink(missing_ok=True)
        return lines


def forget_connections() -> None:
    """Without this, connections with other credentials would be reused."""
    s3fs.S3FileSystem.clear_instance_cache()


def await_file(path: Path, process: subprocess.Popen[bytes]) -> None:
    while not path.exists():
        assert process.poll() is None, "ended too early"
        time.sleep(0.01)


class Elsewhere(Workspace):
    """A workspace whose store is in a bucket. Each `machine` has a mirror of the bucket of its own."""

    def __init__(self, folder: Path, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(folder)
        self.address = address
        self.monkeypatch = monkeypatch
        self.machine("A")

    def machine(self, name: str) -> Elsewhere:
        self.monkeypatch.setenv("GS_HIDER_CACHE", str(self.folder / name))
        return self

    def open(self, *settings: str) -> Project:
        return open_project(self.file, self.address, settings, self.package)

    def store(self) -> RemoteStore:
        store = open_store(self.address)
        assert isinstance(store, RemoteStore)
        return store

    def start(self, *arguments: str, machine: str = "A") -> subprocess.Popen[bytes]:
        environment = {**os.environ, "GS_HIDER_CACHE": str(self.folder / machine), "GS_HIDER_STORE": self.address}
        command = [sys.executable, "-m", "pipeline", "run", str(self.file), "--stages", TOYS, "--json", *arguments]
        return subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        )

    def is_valid(self) -> bool:
        """Whether every record in the bucket has all its artifacts, with every byte sound."""
        store = self.machine(uuid.uuid4().hex).store()
        records = [store.find(key) for key in store.actions]
        return all(record and all(map(store.is_sound, record.outputs.values())) for record in records)
