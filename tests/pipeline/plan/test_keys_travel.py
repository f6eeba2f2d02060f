"""Keys are the same in another process, folder, environment and store."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.pipeline.helpers import CHAIN, TOYS, Workspace

ROOT = Path(__file__).parents[3]


def keys(workflow: Path, store: Path, folder: Path, **environment: str) -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "status", str(workflow), "--store", str(store), "--stages", TOYS, "--json"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return {line["name"]: line["key"] for line in map(json.loads, done.stdout.splitlines())}


def test_keys_travel(workspace: Workspace, tmp_path: Path) -> None:
    (tmp_path / "data.txt").write_text("1\n2\n")
    ran = workspace.write(CHAIN.replace('{count: "${count}"}', '{count: "${count}", file: data.txt}')).run()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("workflow.yaml", "data.txt"):
        shutil.copy(tmp_path / name, elsewhere / name)
    shutil.copytree(tmp_path / "store", elsewhere / "results")
    expected = {name: event.key for name, event in ran.ended.items()}
    settings = {
        "PYTHONHASHSEED": "7",
        "GS_HIDER_DEVICE": "another",
        "LC_ALL": "C",
        "TZ": "Asia/Tokyo",
        "OMP_NUM_THREADS": "1",
    }
    assert keys(elsewhere / "workflow.yaml", elsewhere / "results", elsewhere, **settings) == expected
    assert keys(workspace.file, tmp_path / "store", ROOT, PYTHONHASHSEED="8") == expected
