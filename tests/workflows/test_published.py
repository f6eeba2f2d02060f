"""A container is exported as files, and imported from them as the very same artifact."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.workflows.test_batch_pairs import photograph

REPOSITORY = Path(__file__).parents[2]
IMPORTING = """
name: importing
stages:
  received:
    uses: import_container
    with: {bundle: public, secret: secret, method: homogeneous}
"""


def run(
    workflow: Path, store: Path, *arguments: str, module: str = "pipeline", **environment: str
) -> dict[str, dict[str, Path]]:
    """Run a workflow. Returns the outputs of its stages by name. All in one process, as each takes seconds to start."""
    command = [sys.executable, "-m", module, "run", str(workflow), "--store", str(store), "--json", "--serial"]
    finished = subprocess.run(
        [*command, *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1"} | environment,
    )
    assert finished.returncode == 0, finished.stderr
    events = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    ended = {event["name"]: event for event in events if event["event"] == "stage"}
    return {
        name: {output: Path(path) for output, path in event["outputs"].items()}
        for name, event in ended.items()
        if event["outputs"]
    }


@pytest.mark.slow  # a minute: SfM and three trainings
def test_what_is_published_can_be_received(tmp_path: Path) -> None:
    for seed, name in enumerate(("cover", "message")):
        photograph(seed, tmp_path / name)
    changes = {"cover": tmp_path / "cover", "message": tmp_path / "message", "width": 64, "iterations": 10}
    settings = [f"--set={name}={value}" for name, value in changes.items()]
    made = run(REPOSITORY / "workflows" / "hide_photos.yaml", tmp_path / "store", "published", *settings)
    public, secret = made["published"]["bundle"], made["published"]["secret_bundle"]
    assert {path.name for path in public.iterdir()} >= {"container.ply", "container.json", "scene_decoder.safetensors"}
    assert not any(b"message" in path.read_bytes() for path in public.iterdir())
    assert json.loads((public / "manifest.json").read_text())["private"] is False
    assert secret.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o077 == 0 for path in secret.iterdir())

    (tmp_path / "importing.yaml").write_text(IMPORTING)
    (tmp_path / "public").symlink_to(public.resolve())
    (tmp_path / "secret").symlink_to(secret.resolve())
    received = run(tmp_path / "importing.yaml", tmp_path / "store")["received"]
    for output in ("container", "secret"):
        assert received[output].resolve().name == made["sealed"][output].resolve().name
