"""Trained splats as a message: the workflow is valid, and what is made from the message is private."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.stages.scene.splat_files.files import columns, write_ply
from tests.stages.test_photos import take

REPOSITORY = Path(__file__).parents[2]


def test_splats_without_photos_are_imported_in_private(tmp_path: Path, store: Path) -> None:
    take(tmp_path / "cover" / "a.jpg")
    write_ply(tmp_path / "message.ply", columns(20, 1))
    command = [sys.executable, "-m", "pipeline", "run", "workflows/hide_splats.yaml", "message_splats", "--serial"]
    given = (f"cover={tmp_path / 'cover'}", f"message={tmp_path / 'message.ply'}", "up=z")
    finished = subprocess.run(
        [*command, "--json", "--store", str(store), *(f"--set={one}" for one in given)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    events = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    (ended,) = [event for event in events if event["event"] == "stage"]
    assert (ended["name"], ended["state"]) == ("message_splats", "ran")
    assert Path(ended["outputs"]["splats"]).stat().st_mode & 0o077 == 0
