"""Fixtures: a workspace whose kernel cache is not the user's, and for the tests that ask for it, a bucket."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.pipeline.helpers import Workspace

if TYPE_CHECKING:
    from tests.pipeline.elsewhere import Elsewhere, Server

NEEDED = {
    "s3fs": 'stores in a bucket are tested with pip install "gs-hider[dev]"',
    "moto": 'the server of objects is in pip install "gs-hider[dev]"',
}


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "kernels"))
    return Workspace(tmp_path)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    for module, why in NEEDED.items():
        pytest.importorskip(module, reason=why)
    from tests.pipeline.elsewhere import ROOT, Server, await_file

    folder = tmp_path_factory.mktemp("server")
    command = [sys.executable, "-m", "tests.pipeline.object_server", str(folder)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE) as process:
        await_file(folder / "port", process)
        yield Server(folder, int((folder / "port").read_text()))
        assert process.stdin
        process.stdin.close()


@pytest.fixture
def remote(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Elsewhere:
    from pipeline.store.bucket.bucket import Bucket
    from tests.pipeline.elsewhere import SECRET, Elsewhere

    for name in [name for name in os.environ if name.startswith(("AWS_", "GS_HIDER_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "reader")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "kernels"))
    for name in ("deny", "break", "hold", "held", "requests"):
        (server.folder / name).unlink(missing_ok=True)
    name = f"b{uuid.uuid4().hex}"
    Bucket(f"s3://{name}")._call("create_bucket")
    return Elsewhere(tmp_path, f"s3://{name}/some/store", monkeypatch)
